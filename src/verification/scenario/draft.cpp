// SPDX-License-Identifier: Apache-2.0
// Draft: TOML to values by the table of keys, and the dice.
#include <cmath>
#include <set>
#include <sstream>

#include <fmt/format.h>

#define TOML_EXCEPTIONS 0
#define TOML_HEADER_ONLY 1
#include <toml++/toml.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "verification/scenario/keys.h"
#include "verification/scenario/scenario.h"

namespace astronav::scenario {
namespace {

using Value = Draft::Value;

tl::unexpected<Error> bad(std::string_view where, std::string_view sentence) {
  return fail(ErrorCode::invalid_argument, "{s}", {}, where, sentence);
}

std::string place(std::string_view file, const toml::source_region& region) {
  return fmt::format("{}:{}:{}", file, region.begin.line, region.begin.column);
}

bool is_number(const toml::node& node) {
  return node.is_integer() || node.is_floating_point();
}
double number(const toml::node& node) {
  return node.value<double>().value_or(std::nan(""));
}

bool is_integer(const Key& key) {
  return std::holds_alternative<int* (*)(Scenario&)>(key.member);
}

Result<void> check_range(const Key& key, double v, std::string_view where) {
  if (std::isnan(v) || v < key.min || v > key.max) {
    return bad(where, fmt::format("{} = {} is outside {} to {}{}{}", key.name, v, key.min, key.max,
                                  key.unit.empty() ? "" : " ", key.unit));
  }
  return {};
}

// { gaussian = { mean = .., sigma = .. } } or { uniform = { min = .., max = .. } }
Result<Value> read_distribution(const Key& key, const toml::table& table, std::string_view where) {
  static constexpr const char* kForms =
      "must be a number, { gaussian = { mean = .., sigma = .. } } or { uniform = { min = .., max = .. } }";
  const auto refuse = [&] { return bad(where, fmt::format("{} {}", key.name, kForms)); };
  if (table.size() != 1) return refuse();
  const bool gaussian = table.contains("gaussian");
  const toml::table* law = table.get_as<toml::table>(gaussian ? "gaussian" : "uniform");
  if (law == nullptr || law->size() != 2) return refuse();
  const toml::node* a = law->get(gaussian ? "mean" : "min");
  const toml::node* b = law->get(gaussian ? "sigma" : "max");
  if (a == nullptr || b == nullptr || !is_number(*a) || !is_number(*b)) return refuse();
  Value value;
  value.kind = gaussian ? Value::Kind::gaussian : Value::Kind::uniform;
  value.a = number(*a);
  value.b = number(*b);
  if (gaussian ? !(value.b >= 0.0) : !(value.b >= value.a)) {
    return bad(where,
               fmt::format("{}: {}", key.name, gaussian ? "sigma must not be negative" : "max must not be below min"));
  }
  if (auto ok = check_range(key, value.a, where); !ok) return forward(ok);
  if (auto ok = check_range(key, gaussian ? value.a : value.b, where); !ok) return forward(ok);
  return value;
}

Result<Value> read_value(const Key& key, const toml::node& node, std::string_view where) {
  Value value;
  if (key.is_number()) {
    if (const toml::table* table = node.as_table()) return read_distribution(key, *table, where);
    if (!is_number(node))
      return bad(where, fmt::format("{} must be a number{}", key.name,
                                    key.unit.empty() ? "" : fmt::format(" ({})", key.unit)));
    value.a = number(node);
    if (auto ok = check_range(key, value.a, where); !ok) return forward(ok);
    if (is_integer(key) && value.a != std::floor(value.a))
      return bad(where, fmt::format("{} must be a whole number", key.name));
    return value;
  }
  if (std::holds_alternative<bool* (*)(Scenario&)>(key.member)) {
    if (!node.is_boolean()) return bad(where, fmt::format("{} must be true or false", key.name));
    value.kind = Value::Kind::flag;
    value.flag = *node.value<bool>();
    return value;
  }
  if (std::holds_alternative<std::vector<std::string>* (*)(Scenario&)>(key.member)) {
    value.kind = Value::Kind::names;
    const toml::array* array = node.as_array();
    if (array == nullptr)
      return bad(where, fmt::format("{} must be a list of names, like [\"earth\", \"mars\"]", key.name));
    for (const toml::node& item : *array) {
      if (!item.is_string()) return bad(where, fmt::format("{} must hold texts only", key.name));
      value.names.push_back(*item.value<std::string>());
    }
    return value;
  }
  value.kind = Value::Kind::text;
  if (std::holds_alternative<Epoch* (*)(Scenario&)>(key.member)) {
    if (node.is_date() || node.is_date_time()) {  // TOML's own dates carry no scale
      std::ostringstream out;
      if (node.is_date()) {
        out << *node.value<toml::date>();
      } else {
        out << *node.value<toml::date_time>();
      }
      value.text = out.str();
    } else if (node.is_string()) {
      value.text = *node.value<std::string>();
    } else {
      return bad(where, fmt::format("{} must be an epoch, like \"2026-11-09T00:00:00 TDB\"", key.name));
    }
    if (auto epoch = Epoch::parse(value.text); !epoch) {
      return bad(where, fmt::format("{}: {}", key.name, describe(epoch.error())));
    }
    return value;
  }
  if (!node.is_string()) return bad(where, fmt::format("{} must be a text in quotes", key.name));
  value.text = *node.value<std::string>();
  if (!key.choices.empty()) {
    std::istringstream choices{std::string(key.choices)};
    bool known = false;
    for (std::string choice; choices >> choice;) known = known || choice == value.text;
    if (!known) return bad(where, fmt::format("{} = \"{}\": must be one of: {}", key.name, value.text, key.choices));
  }
  return value;
}

bool is_section(std::string_view name) {
  for (const Key& key : keys()) {
    if (key.name.size() > name.size() && key.name.substr(0, name.size()) == name && key.name[name.size()] == '.')
      return true;
  }
  return false;
}

using Values = std::map<std::string, Value, std::less<>>;

Result<void> read_table(const toml::table& table, const std::string& prefix, std::string_view file, Values& out) {
  for (const auto& [key_text, node] : table) {
    const std::string name = prefix + std::string(key_text.str());
    const std::string where = place(file, key_text.source());
    if (prefix.empty() && name == "run") continue;
    if (const Key* key = find_key(name)) {
      auto value = read_value(*key, node, where);
      if (!value) return forward(value);
      value->where = where;
      out[name] = std::move(*value);
    } else if (node.is_table() && is_section(name)) {
      if (auto ok = read_table(*node.as_table(), name + ".", file, out); !ok) return ok;
    } else if (node.is_table() && !node.as_table()->empty()) {
      // A misspelt section: its first key says best what was meant.
      const std::string full = name + "." + std::string(node.as_table()->begin()->first.str());
      return bad(where,
                 fmt::format("unknown section \"{}\"; did you mean \"{}\"?", name, section_of(nearest_key(full))));
    } else {
      return bad(where, fmt::format("unknown key \"{}\"; did you mean \"{}\"?", name, nearest_key(name)));
    }
  }
  return {};
}

// [run] of a resolved scenario.
Result<void> read_run(const toml::table& root, std::string_view file, std::uint64_t& seed, std::uint64_t& sample,
                      std::string& level) {
  const toml::node* node = root.get("run");
  if (node == nullptr) return {};
  const toml::table* run = node->as_table();
  if (run == nullptr) return bad(place(file, node->source()), "\"run\" must be a section");
  for (const auto& [key_text, value] : *run) {
    const std::string_view key = key_text.str();
    const std::string where = place(file, key_text.source());
    if (key == "seed" || key == "sample") {
      const auto number = value.value<std::int64_t>();
      if (!number || *number < 0) return bad(where, fmt::format("run.{} must be a whole number, not negative", key));
      (key == "seed" ? seed : sample) = static_cast<std::uint64_t>(*number);
    } else if (key == "version" || key == "level") {
      const auto text = value.value<std::string>();
      if (!text) return bad(where, fmt::format("run.{} must be a text in quotes", key));
      if (key == "level") level = *text;
    } else {
      return bad(where, fmt::format("unknown key \"run.{}\"; [run] holds version, level, seed and sample", key));
    }
  }
  return {};
}

}  // namespace

Result<Draft> Draft::parse(std::string_view toml_text, std::string_view name_for_errors) {
  const toml::parse_result parsed = toml::parse(toml_text);
  if (!parsed) {
    return bad(place(name_for_errors, parsed.error().source()),
               fmt::format("not TOML: {}", parsed.error().description()));
  }
  const toml::table& root = parsed.table();
  Draft draft;
  if (auto ok = read_table(root, "", name_for_errors, draft.values_); !ok) return forward(ok);
  if (auto ok = read_run(root, name_for_errors, draft.seed_, draft.sample_, draft.level_); !ok) return forward(ok);
  return draft;
}

Result<Draft> Draft::read(const std::filesystem::path& path_or_name) {
  std::filesystem::path path = path_or_name;
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored) && !path.has_extension() && !path.has_parent_path()) {
    path = home_directory() / "scenarios" / (path_or_name.string() + ".toml");
  }
  const auto file = MappedFile::open(path);
  if (!file) return forward(file, path_or_name.string());
  if (file->text().find_first_not_of(" \t\r\n") == std::string_view::npos)
    return bad(path.string(), "the file is empty, where a scenario in TOML was expected");
  auto draft = parse(file->text(), path.string());
  if (!draft) return draft;
  for (auto& [name, value] : draft->values_) {
    const Key* key = find_key(name);
    if (!key->is_path || value.text.empty()) continue;
    const std::filesystem::path beside = path.parent_path() / value.text;
    if (std::filesystem::is_regular_file(beside, ignored)) value.text = beside.string();
  }
  return draft;
}

Result<void> Draft::set(std::string_view key_equals_value) {
  const std::string where = fmt::format("--set {}", key_equals_value);
  const std::size_t equals = key_equals_value.find('=');
  if (equals == std::string_view::npos) return bad(where, "expected key=value, like conops.cycle_days=5");
  const auto trim = [](std::string_view s) {
    while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
    while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
    return s;
  };
  const std::string name(trim(key_equals_value.substr(0, equals)));
  const std::string text(trim(key_equals_value.substr(equals + 1)));
  const Key* key = find_key(name);
  if (key == nullptr)
    return bad(where, fmt::format("unknown key \"{}\"; did you mean \"{}\"?", name, nearest_key(name)));
  const bool textual = std::holds_alternative<std::string* (*)(Scenario&)>(key->member) ||
                       std::holds_alternative<Epoch* (*)(Scenario&)>(key->member);
  toml::table table;
  if (textual && (text.empty() || (text.front() != '"' && text.front() != '\''))) {
    table.insert("value", text);
  } else {
    toml::parse_result parsed = toml::parse("value = " + text);
    if (!parsed || parsed.table().size() != 1) return bad(where, fmt::format("\"{}\" is not a TOML value", text));
    table = std::move(parsed).table();
  }
  auto value = read_value(*key, *table.get("value"), where);
  if (!value) return forward(value);
  value->where = where;
  values_[name] = std::move(*value);
  return {};
}

namespace {

struct Setter {
  Scenario& scenario;
  const Value& value;
  double drawn;
  void operator()(double* (*member)(Scenario&)) const { *member(scenario) = drawn; }
  void operator()(int* (*member)(Scenario&)) const { *member(scenario) = static_cast<int>(std::lround(drawn)); }
  void operator()(bool* (*member)(Scenario&)) const { *member(scenario) = value.flag; }
  void operator()(std::string* (*member)(Scenario&)) const { *member(scenario) = value.text; }
  void operator()(std::vector<std::string>* (*member)(Scenario&)) const { *member(scenario) = value.names; }
  void operator()(Epoch* (*member)(Scenario&)) const {
    *member(scenario) = *Epoch::parse(value.text);
  }  // checked on reading
};

}  // namespace

Result<Scenario> Draft::resolve(std::uint64_t seed, std::uint64_t sample) const {
  Scenario scenario;
  for (const auto& [name, value] : values_) {
    const Key& key = *find_key(name);
    double drawn = value.a;
    if (value.kind == Value::Kind::gaussian || value.kind == Value::Kind::uniform) {
      RandomStream stream(StreamId{.seed = seed, .sample = sample, .image = 0, .purpose = name});
      drawn = value.kind == Value::Kind::gaussian ? stream.normal(value.a, value.b) : stream.uniform(value.a, value.b);
      if (is_integer(key)) drawn = std::round(drawn);
    }
    if (key.is_number()) {
      if (auto ok = check_range(key, drawn, value.where); !ok) return forward(ok);
    }
    std::visit(Setter{scenario, value, drawn}, key.member);
  }
  return scenario;
}

std::vector<std::string> Draft::distributions() const {
  std::vector<std::string> names;
  for (const auto& [name, value] : values_) {
    if (value.kind == Value::Kind::gaussian || value.kind == Value::Kind::uniform) names.push_back(name);
  }
  return names;
}

namespace {

// Sections in the table's order; `text` gives the value of each key.
template <typename Text>
std::string write_sections(Text&& text) {
  std::string out;
  std::string_view section;
  for (const Key& key : keys()) {
    if (section_of(key.name) != section) {
      section = section_of(key.name);
      out += fmt::format("{}[{}]\n", out.empty() ? "" : "\n", section);
    }
    out += fmt::format("{} = {}\n", leaf_of(key.name), text(key));
  }
  return out;
}

}  // namespace

std::string Draft::to_toml() const {
  // What is not a distribution resolves to the same text for every seed.
  const auto fixed = [&] {
    Draft copy = *this;
    for (const std::string& name : distributions()) copy.values_.erase(name);
    return copy.resolve(0).value_or(Scenario{});
  }();
  return write_sections([&](const Key& key) {
    const auto it = values_.find(key.name);
    if (it == values_.end() || (it->second.kind != Value::Kind::gaussian && it->second.kind != Value::Kind::uniform)) {
      return value_text(key, fixed);
    }
    const bool gaussian = it->second.kind == Value::Kind::gaussian;
    return fmt::format("{{ {} = {{ {} = {}, {} = {} }} }}", gaussian ? "gaussian" : "uniform",
                       gaussian ? "mean" : "min", it->second.a, gaussian ? "sigma" : "max", it->second.b);
  });
}

std::string to_toml(const Scenario& scenario, const RunHeader& run) {
  return fmt::format(
             "# Every value that this run used; fly it again with: astronav run scenario.resolved.toml\n"
             "[run]\nversion = \"{}\"\nlevel = \"{}\"\nseed = {}\nsample = {}\n\n",
             run.version, run.level, run.seed, run.sample) +
         write_sections([&](const Key& key) { return value_text(key, scenario); });
}

}  // namespace astronav::scenario
