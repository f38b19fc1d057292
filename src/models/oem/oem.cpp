// SPDX-License-Identifier: Apache-2.0
#include "models/oem/oem.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cmath>
#include <map>
#include <utility>

#include <fmt/format.h>

namespace astronav {
namespace {

constexpr std::string_view kBlank = " \t";
// Between segments: what two roundings of the same state may differ by.
constexpr double kJoinPosition_m = 1.0;
constexpr double kJoinVelocity_m_s = 1e-3;
// START_TIME and STOP_TIME are often rounded to the second.
constexpr Duration kSpanSlack = Duration::seconds(1.0);

struct Place {
  int line = 1;
  int column = 1;
};

struct Word {
  std::string_view text;
  Place place;
};

// A keyword with its value, as in "OBJECT_NAME = MARS EXPRESS".
struct Entry {
  Word key;
  Word value;
};

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

class Parser {
 public:
  Parser(std::string_view text, std::string_view name) : text_(text), name_(name) {}

  Result<Oem> run() {
    if (auto r = header(); !r) return forward(r);
    while (have_line_) {
      if (auto r = segment(); !r) return forward(r);
    }
    if (oem_.states.empty()) return error("the message holds no segment (META_START)", Place{line_.place.line, 1});
    // Not stable_sort: its buffer does not honour the alignment of Eigen's matrices.
    std::sort(oem_.covariances.begin(), oem_.covariances.end(),
              [](const auto& a, const auto& b) { return a.epoch < b.epoch; });
    return std::move(oem_);
  }

 private:
  struct Metadata {
    std::string object_name, object_id, frame;
    BodyId center;
    TimeScale scale = TimeScale::tdb;
    std::optional<Epoch> start, stop, useable_start, useable_stop;
  };

  std::string at(Place p) const { return fmt::format("{}:{}:{}", name_, p.line, p.column); }
  tl::unexpected<Error> error(const char* text, Place p, std::string_view subject = {},
                              ErrorCode code = ErrorCode::corrupt_data, std::array<double, 4> numbers = {}) const {
    return fail(code, text, numbers, at(p), subject);
  }
  // The same error, said of a place in this file.
  tl::unexpected<Error> error(Error e, Place p) const {
    e.where = FixedText<200>(at(p));
    return tl::unexpected<Error>(e);
  }

  // Moves to the next line that is not blank; `line_` is without blanks at its ends.
  Result<void> next_line() {
    while (position_ < text_.size()) {
      std::string_view raw = text_.substr(position_, text_.find('\n', position_) - position_);
      position_ += raw.size() + 1;
      ++number_;
      if (!raw.empty() && raw.back() == '\r') raw.remove_suffix(1);
      for (std::size_t i = 0; i < raw.size(); ++i) {
        const auto c = static_cast<unsigned char>(raw[i]);
        if ((c < 0x20 && c != '\t') || c > 0x7e) {
          return error("byte {0} is not printable ASCII", {number_, static_cast<int>(i) + 1}, {},
                       ErrorCode::corrupt_data, {static_cast<double>(c)});
        }
      }
      const std::size_t first = raw.find_first_not_of(kBlank);
      if (first == std::string_view::npos) continue;
      line_ = {raw.substr(first, raw.find_last_not_of(kBlank) - first + 1), {number_, static_cast<int>(first) + 1}};
      have_line_ = true;
      return {};
    }
    have_line_ = false;
    return {};
  }

  Result<void> require_line(const char* missing) {
    if (auto r = next_line(); !r) return r;
    if (!have_line_) return error(missing, {number_ + 1, 1});
    return {};
  }

  // The part of the line from byte `from` on, without blanks at its beginning.
  Word rest(std::size_t from) const {
    std::size_t first = line_.text.find_first_not_of(kBlank, from);
    if (first == std::string_view::npos) first = line_.text.size();
    return {line_.text.substr(first), {line_.place.line, line_.place.column + static_cast<int>(first)}};
  }

  std::vector<Word> words() const {
    std::vector<Word> out;
    for (Word w = line_; !w.text.empty();) {
      const std::size_t length = std::min(w.text.find_first_of(kBlank), w.text.size());
      out.push_back({w.text.substr(0, length), w.place});
      w = rest(static_cast<std::size_t>(w.place.column - line_.place.column) + length);
    }
    return out;
  }

  bool line_is(std::string_view keyword) const { return line_.text == keyword; }
  bool comment() const {
    return line_.text == "COMMENT" || line_.text.starts_with("COMMENT ") || line_.text.starts_with("COMMENT\t");
  }

  Result<Entry> entry() const {
    const std::size_t equals = line_.text.find('=');
    if (equals == std::string_view::npos)
      return error("expected 'KEYWORD = value', found '{s}'", line_.place, line_.text);
    const std::string_view key = line_.text.substr(0, equals);
    const Entry e{{key.substr(0, key.find_last_not_of(kBlank) + 1), line_.place}, rest(equals + 1)};
    if (e.value.text.empty()) return error("{s} has no value", e.value.place, e.key.text);
    return e;
  }

  Result<double> number(const Word& w) const {
    const char* first = w.text.data();
    const char* last = first + w.text.size();
    if (first != last && *first == '+' && w.text.size() > 1 && w.text[1] != '-') ++first;
    double value = 0.0;
    const auto [end, ec] = std::from_chars(first, last, value);
    if (ec != std::errc{} || end != last || !std::isfinite(value))
      return error("'{s}' is not a number", w.place, w.text);
    return value;
  }

  // "2026-11-09T00:00:00.5" or, with the day of the year, "2026-313T00:00:00.5"; a final Z only for UTC.
  Result<Epoch> epoch(const Word& w, TimeScale scale) const {
    constexpr const char* expected = "'{s}' is not an epoch: expected YYYY-MM-DDThh:mm:ss or YYYY-DDDThh:mm:ss";
    std::string_view s = w.text;
    if (!s.empty() && s.back() == 'Z') {
      if (scale != TimeScale::utc) return error("'{s}' ends in Z, but the time system is not UTC", w.place, w.text);
      s.remove_suffix(1);
    }
    const std::size_t t = s.find('T');
    const auto digits = [&s](std::size_t from, std::size_t count) {
      return std::all_of(s.begin() + from, s.begin() + from + count, is_digit);
    };
    if ((t != 8 && t != 10) || s.size() < t + 9 || !digits(0, 4) || s[4] != '-' || s[t + 3] != ':' || s[t + 6] != ':' ||
        !std::all_of(s.begin() + t + 1, s.end(), [](char c) { return is_digit(c) || c == ':' || c == '.'; })) {
      return error(expected, w.place, w.text);
    }
    std::string iso(s);
    if (t == 8) {
      if (!digits(5, 3)) return error(expected, w.place, w.text);
      const int year = (s[0] - '0') * 1000 + (s[1] - '0') * 100 + (s[2] - '0') * 10 + (s[3] - '0');
      const int day_of_year = (s[5] - '0') * 100 + (s[6] - '0') * 10 + (s[7] - '0');
      const std::chrono::year y(year);
      if (day_of_year < 1 || day_of_year > (y.is_leap() ? 366 : 365)) {
        return error("{0} has no day {1}", w.place, {}, ErrorCode::corrupt_data,
                     {static_cast<double>(year), static_cast<double>(day_of_year)});
      }
      const std::chrono::year_month_day date =
          std::chrono::sys_days(y / std::chrono::January / 1) + std::chrono::days(day_of_year - 1);
      iso = fmt::format("{:04}-{:02}-{:02}{}", year, static_cast<unsigned>(date.month()),
                        static_cast<unsigned>(date.day()), s.substr(t));
    }
    auto parsed = Epoch::parse(iso, scale);
    if (!parsed) return error(parsed.error(), w.place);
    return *parsed;
  }

  static std::string frame_axes(std::string_view frame) {
    // All of these are within 25 milli-arcsec of the ICRF axes and are taken as such.
    for (const std::string_view known : {"ICRF", "GCRF", "EME2000", "J2000"}) {
      if (frame == known) return "ICRF";
    }
    return {};
  }

  static bool is_orbital(std::string_view frame) { return frame == "RTN" || frame == "RSW" || frame == "TNW"; }

  // Between two states the cubic of both: good to far better than the axes that come of it need.
  static State state_at(Epoch at, const std::vector<Epoch>& epochs, const std::vector<State>& states) {
    const auto next = std::lower_bound(epochs.begin(), epochs.end(), at) - epochs.begin();
    if (epochs[next] == at) return states[next];
    const State &a = states[next - 1], &b = states[next];
    const double h = (epochs[next] - epochs[next - 1]).seconds();
    const double x = (at - epochs[next - 1]).seconds() / h;
    const Vec3 d = b.p_m - a.p_m, va = h * a.v_m_s, vb = h * b.v_m_s;
    const Vec3 c2 = 3.0 * d - 2.0 * va - vb, c3 = va + vb - 2.0 * d;
    return {a.p_m + x * (va + x * (c2 + x * c3)), (va + x * (2.0 * c2 + x * 3.0 * c3)) / h};
  }

  // RTN, RSW: along the radius, across it on the side of the velocity, along the angular momentum. TNW: along the
  // velocity, the third of the right-handed triad, along the angular momentum.
  static Mat3 axes_of(std::string_view frame, const State& s) {
    Mat3 axes;
    const Vec3 w = s.p_m.cross(s.v_m_s).normalized();
    axes.col(0) = frame == "TNW" ? s.v_m_s.normalized() : s.p_m.normalized();
    axes.col(1) = w.cross(axes.col(0));
    axes.col(2) = w;
    return axes;
  }

  Result<void> header() {
    if (auto r = require_line("the file is empty; expected CCSDS_OEM_VERS"); !r) return r;
    if (line_.text.front() == '<') {
      return error("this looks like XML; only the keyword (KVN) form is read", line_.place, {}, ErrorCode::unsupported);
    }
    if (!line_.text.starts_with("CCSDS_OEM_VERS")) {
      return error("not an Orbit Ephemeris Message: expected CCSDS_OEM_VERS, found '{s}'", line_.place, line_.text);
    }
    auto version = entry();
    if (!version) return forward(version);
    if (version->key.text != "CCSDS_OEM_VERS") return error("unknown keyword '{s}'", line_.place, version->key.text);
    if (version->value.text != "1.0" && version->value.text != "2.0" && version->value.text != "3.0") {
      return error("version {s} is not read; 1.0, 2.0 and 3.0 are", version->value.place, version->value.text,
                   ErrorCode::unsupported);
    }
    std::map<std::string, std::string, std::less<>> seen;
    for (;;) {
      if (auto r = require_line("the header ends without META_START"); !r) return r;
      if (line_is("META_START")) break;
      if (comment()) {
        oem_.comments.emplace_back(rest(7).text);
        continue;
      }
      auto e = entry();
      if (!e) return forward(e);
      const std::string_view key = e->key.text;
      if (key != "CREATION_DATE" && key != "ORIGINATOR" && key != "CLASSIFICATION" && key != "MESSAGE_ID") {
        return error("unknown keyword '{s}' in the header", e->key.place, key);
      }
      if (!seen.emplace(key, e->value.text).second) return error("{s} is given twice", e->key.place, key);
      if (key == "CREATION_DATE") {
        if (auto r = epoch(e->value, TimeScale::utc); !r) return forward(r);
      }
    }
    for (const char* key : {"CREATION_DATE", "ORIGINATOR"}) {
      if (!seen.contains(key)) return error("the header lacks {s}", line_.place, key);
    }
    oem_.creation_date = seen["CREATION_DATE"];
    oem_.originator = seen["ORIGINATOR"];
    return {};
  }

  Result<Metadata> metadata() {
    static constexpr std::array mandatory{"OBJECT_NAME", "OBJECT_ID",  "CENTER_NAME", "REF_FRAME",
                                          "TIME_SYSTEM", "START_TIME", "STOP_TIME"};
    static constexpr std::array optional{"REF_FRAME_EPOCH", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "INTERPOLATION",
                                         "INTERPOLATION_DEGREE"};
    std::map<std::string, Word, std::less<>> values;
    for (;;) {
      if (auto r = require_line("the metadata end without META_STOP"); !r) return forward(r);
      if (line_is("META_STOP")) break;
      if (comment()) continue;
      auto e = entry();
      if (!e) return forward(e);
      const auto is_key = [&e](const char* k) { return e->key.text == k; };
      if (std::none_of(mandatory.begin(), mandatory.end(), is_key) &&
          std::none_of(optional.begin(), optional.end(), is_key)) {
        return error("unknown keyword '{s}' in the metadata", e->key.place, e->key.text);
      }
      if (!values.emplace(e->key.text, e->value).second) return error("{s} is given twice", e->key.place, e->key.text);
    }
    for (const char* key : mandatory) {
      if (!values.contains(key)) return error("the metadata lack {s}", line_.place, key);
    }
    Metadata m;
    m.object_name = values["OBJECT_NAME"].text;
    m.object_id = values["OBJECT_ID"].text;

    const Word scale = values["TIME_SYSTEM"];
    static constexpr std::array<std::pair<std::string_view, TimeScale>, 4> scales{
        {{"TDB", TimeScale::tdb}, {"TT", TimeScale::tt}, {"TAI", TimeScale::tai}, {"UTC", TimeScale::utc}}};
    const auto known = std::find_if(scales.begin(), scales.end(), [&](const auto& s) { return s.first == scale.text; });
    if (known == scales.end()) {
      return error("time system '{s}' is not handled; TDB, TT, TAI and UTC are", scale.place, scale.text,
                   ErrorCode::unsupported);
    }
    m.scale = known->second;

    const Word frame = values["REF_FRAME"];
    m.frame = frame_axes(frame.text);
    if (m.frame.empty()) {
      return error("frame '{s}' is not handled; ICRF, GCRF, EME2000 and J2000 are", frame.place, frame.text,
                   ErrorCode::unsupported);
    }
    auto center = parse_body(values["CENTER_NAME"].text);
    if (!center) return error(center.error(), values["CENTER_NAME"].place);
    m.center = *center;

    const std::array<std::pair<const char*, std::optional<Epoch>*>, 4> times{{{"START_TIME", &m.start},
                                                                              {"STOP_TIME", &m.stop},
                                                                              {"USEABLE_START_TIME", &m.useable_start},
                                                                              {"USEABLE_STOP_TIME", &m.useable_stop}}};
    for (const auto& [key, field] : times) {
      const auto it = values.find(key);
      if (it == values.end()) continue;
      auto e = epoch(it->second, m.scale);
      if (!e) return forward(e);
      *field = *e;
    }
    if (*m.stop < *m.start) return error("STOP_TIME lies before START_TIME", values["STOP_TIME"].place);
    for (const auto& [key, field] : times) {
      if (*field && (**field < *m.start || **field > *m.stop)) {
        return error("{s} lies outside START_TIME to STOP_TIME", values.find(key)->second.place, key);
      }
    }
    if (const auto it = values.find("INTERPOLATION_DEGREE"); it != values.end()) {
      auto degree = number(it->second);
      if (!degree) return forward(degree);
      if (*degree < 1.0 || *degree != std::floor(*degree)) {
        return error("INTERPOLATION_DEGREE '{s}' is not a positive whole number", it->second.place, it->second.text);
      }
    } else if (const auto method = values.find("INTERPOLATION"); method != values.end()) {
      return error("INTERPOLATION needs INTERPOLATION_DEGREE", method->second.place);
    }
    return m;
  }

  Result<void> data_line(const Metadata& m, std::vector<Epoch>& epochs, std::vector<State>& states) const {
    const std::vector<Word> w = words();
    auto e = epoch(w[0], m.scale);
    if (!e) return forward(e);
    if (w.size() != 7 && w.size() != 10) {
      return error("expected an epoch and 6 numbers (9 with acceleration), found {0} fields", line_.place, {},
                   ErrorCode::corrupt_data, {static_cast<double>(w.size())});
    }
    std::array<double, 9> v{};
    for (std::size_t i = 1; i < w.size(); ++i) {
      auto x = number(w[i]);
      if (!x) return forward(x);
      v[i - 1] = *x * 1e3;
      if (!std::isfinite(v[i - 1])) return error("'{s}' km is beyond all range", w[i].place, w[i].text);
    }
    if (!epochs.empty() && *e <= epochs.back()) {
      return error("epoch {s} is not later than the one before it", w[0].place, w[0].text);
    }
    if (*e < *m.start - kSpanSlack || *e > *m.stop + kSpanSlack) {
      return error("epoch {s} lies outside START_TIME to STOP_TIME", w[0].place, w[0].text);
    }
    epochs.push_back(*e);
    states.push_back({{v[0], v[1], v[2]}, {v[3], v[4], v[5]}});
    return {};
  }

  // From the line after COVARIANCE_START to COVARIANCE_STOP. Covariances on the orbit's own axes are turned to N with
  // the segment's states.
  Result<void> covariance_block(const Metadata& m, const std::vector<Epoch>& epochs, const std::vector<State>& states) {
    if (auto r = require_line("the covariances end without COVARIANCE_STOP"); !r) return r;
    while (!line_is("COVARIANCE_STOP")) {
      if (comment()) {
        if (auto r = require_line("the covariances end without COVARIANCE_STOP"); !r) return r;
        continue;
      }
      auto e = entry();
      if (!e) return forward(e);
      if (e->key.text != "EPOCH")
        return error("expected EPOCH or COVARIANCE_STOP, found '{s}'", e->key.place, e->key.text);
      auto when = epoch(e->value, m.scale);
      if (!when) return forward(when);
      OemCovariance c{*when, {}};
      std::optional<Mat3> orbital_axes;  // N from those of the covariance
      if (auto r = require_line("the covariances end without COVARIANCE_STOP"); !r) return r;
      if (line_.text.starts_with("COV_REF_FRAME")) {
        auto frame = entry();
        if (!frame) return forward(frame);
        if (frame->key.text != "COV_REF_FRAME")
          return error("unknown keyword '{s}'", frame->key.place, frame->key.text);
        if (is_orbital(frame->value.text)) {
          if (*when < epochs.front() || *when > epochs.back()) {
            return error("a covariance on the orbit's axes lies outside the states of its segment", e->value.place);
          }
          orbital_axes = axes_of(frame->value.text, state_at(*when, epochs, states));
          if (!(orbital_axes->determinant() > 0.5)) return error("the state gives no orbital axes", frame->value.place);
        } else if (frame_axes(frame->value.text).empty()) {
          return error("covariance frame '{s}' is not handled; ICRF, GCRF, EME2000, J2000, RTN, RSW and TNW are",
                       frame->value.place, frame->value.text, ErrorCode::unsupported);
        }
        if (auto r = require_line("the covariances end without COVARIANCE_STOP"); !r) return r;
      }
      for (int row = 0; row < 6; ++row) {
        const std::vector<Word> w = words();
        if (static_cast<int>(w.size()) != row + 1) {
          return error("row {0} of a covariance has {0} numbers, found {1} fields", line_.place, {},
                       ErrorCode::corrupt_data, {row + 1.0, static_cast<double>(w.size())});
        }
        for (int column = 0; column <= row; ++column) {
          auto x = number(w[column]);
          if (!x) return forward(x);
          c.covariance(row, column) = c.covariance(column, row) = *x * 1e6;
          if (!std::isfinite(c.covariance(row, column))) {
            return error("'{s}' is beyond all range", w[column].place, w[column].text);
          }
        }
        if (c.covariance(row, row) < 0.0) return error("variance {s} is negative", w[row].place, w[row].text);
        if (auto r = require_line("the covariances end without COVARIANCE_STOP"); !r) return r;
      }
      if (orbital_axes) {
        Mat6 turn = Mat6::Zero();
        turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = *orbital_axes;
        const Mat6 turned = turn * c.covariance * turn.transpose();
        c.covariance = 0.5 * (turned + turned.transpose());
      }
      oem_.covariances.push_back(c);
    }
    return next_line();
  }

  // From META_START to the next one or the end.
  Result<void> segment() {
    const Place start = line_.place;
    auto m = metadata();
    if (!m) return forward(m);
    std::vector<Epoch> epochs;
    std::vector<State> states;
    if (auto r = next_line(); !r) return r;
    while (have_line_ && (comment() || is_digit(line_.text.front()))) {
      if (!comment()) {
        if (auto r = data_line(*m, epochs, states); !r) return r;
      }
      if (auto r = next_line(); !r) return r;
    }
    const Place after{have_line_ ? line_.place.line : number_ + 1, 1};
    if (epochs.empty()) return error("expected states of the form 'epoch x y z vx vy vz'", after);
    if (epochs.front() > *m->start + kSpanSlack) {
      return error("the states begin later than START_TIME", start);
    }
    if (epochs.back() < *m->stop - kSpanSlack) {
      return error("the states end before STOP_TIME: is the file cut off?", after);
    }
    if (have_line_ && line_is("COVARIANCE_START")) {
      if (auto r = covariance_block(*m, epochs, states); !r) return r;
      while (have_line_ && comment()) {
        if (auto r = next_line(); !r) return r;
      }
    }
    if (have_line_ && !line_is("META_START")) {
      return error("expected META_START or the end of the file, found '{s}'", line_.place, line_.text);
    }
    return join(*m, std::move(epochs), std::move(states), start);
  }

  Result<void> join(const Metadata& m, std::vector<Epoch> epochs, std::vector<State> states, Place start) {
    if (oem_.states.empty()) {
      first_ = m;
      oem_.object_name = m.object_name;
      oem_.object_id = m.object_id;
      oem_.center = m.center;
      oem_.scale = m.scale;
      oem_.epochs = std::move(epochs);
      oem_.states = std::move(states);
      oem_.useable_begin = m.useable_start;
      oem_.useable_end = m.useable_stop;
      return {};
    }
    const auto refuse = [&](const char* text) { return error(text, start, {}, ErrorCode::unsupported); };
    if (m.object_id != first_.object_id) return refuse("this segment is of another object; one object a file is read");
    if (m.center != first_.center) return refuse("this segment has another centre than the one before it");
    if (m.scale != first_.scale) return refuse("this segment has another time system than the one before it");
    if (epochs.front() > oem_.epochs.back())
      return refuse("there is a gap before this segment; it must begin where the last ended");
    if (epochs.front() < oem_.epochs.back())
      return refuse("this segment overlaps the one before it; it must begin where the last ended");
    const State& before = oem_.states.back();
    if ((states.front().p_m - before.p_m).norm() > kJoinPosition_m ||
        (states.front().v_m_s - before.v_m_s).norm() > kJoinVelocity_m_s) {
      return refuse("the state jumps where this segment begins (a manoeuvre?); only smooth trajectories are joined");
    }
    oem_.epochs.insert(oem_.epochs.end(), epochs.begin() + 1, epochs.end());
    oem_.states.insert(oem_.states.end(), states.begin() + 1, states.end());
    oem_.useable_end = m.useable_stop;
    return {};
  }

  std::string_view text_;
  std::string_view name_;
  std::size_t position_ = 0;
  int number_ = 0;
  bool have_line_ = false;
  Word line_;
  Metadata first_;
  Oem oem_;
};

}  // namespace

Result<Oem> parse_oem(std::string_view text, std::string_view name_for_errors) {
  return Parser(text, name_for_errors).run();
}

}  // namespace astronav
