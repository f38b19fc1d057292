// SPDX-License-Identifier: Apache-2.0
#include "models/camera_file/camera_file.h"

#define TOML_EXCEPTIONS 0
#define TOML_HEADER_ONLY 1
#include <algorithm>
#include <array>
#include <cstdlib>
#include <set>
#include <vector>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "foundation/base/nearest_word.h"
#include "foundation/files/mapped_file.h"
#include "foundation/raster/raster.h"

namespace astronav {
namespace {

enum class Need { required, optional };

// One number of the file: where it stands, where it goes, what it may be. The file's unit times `to_si` is the field's.
struct NumberKey {
  const char* section;
  const char* name;
  double& (*field)(Camera&);
  double to_si;
  double min;
  double max;
  Need need;
};
struct IntegerKey {
  const char* section;
  const char* name;
  int& (*field)(Camera&);
  int min;
  int max;
};
// One of two words, or true and false.
struct ChoiceKey {
  const char* section;
  const char* name;
  std::array<std::string_view, 2> words;
  bool (*get)(const Camera&);  // whether it is the second
  void (*set)(Camera&, bool);
  bool is_switch() const { return words[0] == "false"; }
  std::string text(bool second) const {
    return is_switch() ? std::string(words[second]) : fmt::format("\"{}\"", words[second]);
  }
};
// A curve over wavelength: the keys <name>_wavelength_nm and <name>, two lists of the same length.
struct CurveKey {
  const char* section;
  const char* name;
  std::vector<BandPoint>& (*field)(Camera&);
};

constexpr IntegerKey kIntegers[] = {
    {"image", "width_px", [](Camera& c) -> int& { return c.intrinsics.width_px; }, 8, 16384},
    {"image", "height_px", [](Camera& c) -> int& { return c.intrinsics.height_px; }, 8, 16384},
    {"detector", "bits", [](Camera& c) -> int& { return c.detector.bits; }, 1, 16},
};

constexpr NumberKey kNumbers[] = {
    {"", "exposure_ms", [](Camera& c) -> double& { return c.exposure_s; }, 1e-3, 1e-6, 1e7, Need::required},
    {"projection", "fx_px", [](Camera& c) -> double& { return c.intrinsics.fx_px; }, 1, 1, 1e8, Need::optional},
    {"projection", "fy_px", [](Camera& c) -> double& { return c.intrinsics.fy_px; }, 1, 1, 1e8, Need::optional},
    {"projection", "cx_px", [](Camera& c) -> double& { return c.intrinsics.cx_px; }, 1, -1e6, 1e6, Need::optional},
    {"projection", "cy_px", [](Camera& c) -> double& { return c.intrinsics.cy_px; }, 1, -1e6, 1e6, Need::optional},
    {"distortion", "k1", [](Camera& c) -> double& { return c.intrinsics.distortion.k1; }, 1, -1e3, 1e3, Need::optional},
    {"distortion", "k2", [](Camera& c) -> double& { return c.intrinsics.distortion.k2; }, 1, -1e5, 1e5, Need::optional},
    {"distortion", "k3", [](Camera& c) -> double& { return c.intrinsics.distortion.k3; }, 1, -1e7, 1e7, Need::optional},
    {"distortion", "p1", [](Camera& c) -> double& { return c.intrinsics.distortion.p1; }, 1, -1e2, 1e2, Need::optional},
    {"distortion", "p2", [](Camera& c) -> double& { return c.intrinsics.distortion.p2; }, 1, -1e2, 1e2, Need::optional},
    {"optics", "focal_length_mm", [](Camera& c) -> double& { return c.optics.focal_length_m; }, 1e-3, 1e-2, 1e5,
     Need::required},
    {"optics", "pupil_diameter_mm", [](Camera& c) -> double& { return c.optics.pupil_diameter_m; }, 1e-3, 1e-3, 1e5,
     Need::required},
    {"optics", "vignetting_cos_power", [](Camera& c) -> double& { return c.optics.vignetting_cos_power; }, 1, 0, 20,
     Need::optional},
    {"optics", "vignetting_corner_loss", [](Camera& c) -> double& { return c.optics.vignetting_corner_loss; }, 1, 0, 1,
     Need::optional},
    {"optics", "stray_light_e_s_px", [](Camera& c) -> double& { return c.optics.stray_light_e_s_px; }, 1, 0, 1e8,
     Need::optional},
    {"optics", "stray_light_power", [](Camera& c) -> double& { return c.optics.stray_light_power; }, 1, 0, 20,
     Need::optional},
    {"psf", "sigma_px", [](Camera& c) -> double& { return c.psf.sigma_px; }, 1, 0.05, 20, Need::required},
    {"psf", "sigma_growth_px", [](Camera& c) -> double& { return c.psf.sigma_growth_px; }, 1, 0, 20, Need::optional},
    {"psf", "halo_fraction", [](Camera& c) -> double& { return c.psf.halo_fraction; }, 1, 0, 1, Need::optional},
    {"psf", "halo_sigma_px", [](Camera& c) -> double& { return c.psf.halo_sigma_px; }, 1, 0.05, 100, Need::optional},
    {"psf", "halo_offset_u_px", [](Camera& c) -> double& { return c.psf.halo_offset_u_px; }, 1, -100, 100,
     Need::optional},
    {"psf", "halo_offset_v_px", [](Camera& c) -> double& { return c.psf.halo_offset_v_px; }, 1, -100, 100,
     Need::optional},
    {"psf", "coma_px", [](Camera& c) -> double& { return c.psf.coma_px; }, 1, -20, 20, Need::optional},
    {"psf", "kernel_samples_per_px", [](Camera& c) -> double& { return c.psf.kernel.samples_per_px; }, 1, 0.1, 100,
     Need::optional},
    {"detector", "pixel_pitch_um", [](Camera& c) -> double& { return c.detector.pixel_pitch_m; }, 1e-6, 0.1, 1e3,
     Need::required},
    {"detector", "read_noise_e", [](Camera& c) -> double& { return c.detector.read_noise_e; }, 1, 0, 1e5,
     Need::required},
    {"detector", "dark_current_e_s", [](Camera& c) -> double& { return c.detector.dark_current_e_s; }, 1, 0, 1e7,
     Need::required},
    {"detector", "dark_nonuniformity", [](Camera& c) -> double& { return c.detector.dark_nonuniformity; }, 1, 0, 1,
     Need::optional},
    {"detector", "photo_nonuniformity", [](Camera& c) -> double& { return c.detector.photo_nonuniformity; }, 1, 0, 0.3,
     Need::optional},
    {"detector", "full_well_e", [](Camera& c) -> double& { return c.detector.full_well_e; }, 1, 1, 1e9, Need::required},
    {"detector", "gain_e_dn", [](Camera& c) -> double& { return c.detector.gain_e_dn; }, 1, 1e-4, 1e6, Need::required},
    {"detector", "bias_dn", [](Camera& c) -> double& { return c.detector.bias_dn; }, 1, 0, 65535, Need::optional},
    {"detector", "background_e_s_px", [](Camera& c) -> double& { return c.detector.background_e_s_px; }, 1, 0, 1e8,
     Need::optional},
    {"detector", "temperature_c", [](Camera& c) -> double& { return c.detector.temperature_c; }, 1, -273.15, 200,
     Need::optional},
    {"detector", "dark_reference_c", [](Camera& c) -> double& { return c.detector.dark_reference_c; }, 1, -273.15, 200,
     Need::optional},
    {"detector", "dark_doubling_k", [](Camera& c) -> double& { return c.detector.dark_doubling_k; }, 1, 0, 1e3,
     Need::optional},
    {"detector", "hot_pixel_share", [](Camera& c) -> double& { return c.detector.hot_pixel_share; }, 1, 0, 1,
     Need::optional},
    {"detector", "hot_pixel_e_s", [](Camera& c) -> double& { return c.detector.hot_pixel_e_s; }, 1, 0, 1e7,
     Need::optional},
    {"detector", "cosmic_rays_cm2_s", [](Camera& c) -> double& { return c.detector.cosmic_rays_cm2_s; }, 1, 0, 1e6,
     Need::optional},
    {"detector", "cosmic_ray_e_um", [](Camera& c) -> double& { return c.detector.cosmic_ray_e_um; }, 1, 0, 1e5,
     Need::optional},
    {"detector", "depth_um", [](Camera& c) -> double& { return c.detector.depth_um; }, 1, 0.1, 1e4, Need::optional},
    {"detector", "frame_transfer_row_us", [](Camera& c) -> double& { return c.detector.frame_transfer_row_us; }, 1, 0,
     1e6, Need::optional},
    {"detector", "rolling_row_us", [](Camera& c) -> double& { return c.detector.rolling_row_us; }, 1, 0, 1e6,
     Need::optional},
    {"detector", "time_tag_latency_ms", [](Camera& c) -> double& { return c.detector.time_tag_latency_ms; }, 1, -1e6,
     1e6, Need::optional},
    {"detector", "time_tag_jitter_ms", [](Camera& c) -> double& { return c.detector.time_tag_jitter_ms; }, 1, 0, 1e6,
     Need::optional},
};

constexpr ChoiceKey kChoices[] = {
    {"projection",
     "model",
     {"pinhole", "fisheye"},
     [](const Camera& c) { return c.intrinsics.model == ProjectionModel::fisheye; },
     [](Camera& c, bool second) { c.intrinsics.model = second ? ProjectionModel::fisheye : ProjectionModel::pinhole; }},
    {"detector",
     "blooming",
     {"false", "true"},
     [](const Camera& c) { return c.detector.blooming; },
     [](Camera& c, bool second) { c.detector.blooming = second; }},
    {"detector",
     "shutter",
     {"global", "rolling"},
     [](const Camera& c) { return c.detector.shutter == Shutter::rolling; },
     [](Camera& c, bool second) { c.detector.shutter = second ? Shutter::rolling : Shutter::global; }},
};

constexpr CurveKey kCurves[] = {
    {"optics", "transmission", [](Camera& c) -> std::vector<BandPoint>& { return c.optics.transmission; }},
    {"detector", "quantum_efficiency",
     [](Camera& c) -> std::vector<BandPoint>& { return c.detector.quantum_efficiency; }},
};

std::string full_name(std::string_view section, std::string_view name) {
  return section.empty() ? std::string(name) : fmt::format("{}.{}", section, name);
}

std::set<std::string> known_keys() {
  std::set<std::string> keys{"name"};
  for (const auto& key : kIntegers) keys.insert(full_name(key.section, key.name));
  for (const auto& key : kNumbers) keys.insert(full_name(key.section, key.name));
  for (const auto& key : kChoices) keys.insert(full_name(key.section, key.name));
  keys.insert("psf.kernel");
  for (const auto& key : kCurves) {
    keys.insert(full_name(key.section, key.name));
    keys.insert(full_name(key.section, key.name) + "_wavelength_nm");
  }
  return keys;
}

class Parser {
 public:
  Parser(const toml::table& root, std::string_view file) : root_(root), file_(file) {}

  Result<Camera> camera() {
    if (const auto checked = check_keys(); !checked) return forward(checked);
    Camera camera;
    if (const toml::node* node = find("", "name")) {
      const auto text = node->value_exact<std::string>();
      if (!text) return fail(ErrorCode::invalid_argument, "name must be a text in quotes", {}, place(node));
      camera.name = *text;
    }
    for (const IntegerKey& key : kIntegers) {
      if (const auto read = integer(key, camera); !read) return forward(read);
    }
    for (const NumberKey& key : kNumbers) {
      if (const auto read = number(key, camera); !read) return forward(read);
    }
    for (const ChoiceKey& key : kChoices) {
      if (const auto read = choice(key, camera); !read) return forward(read);
    }
    for (const CurveKey& key : kCurves) {
      if (const auto read = curve(key, camera); !read) return forward(read);
    }
    if (const auto read = kernel(camera); !read) return forward(read);
    Intrinsics& projection = camera.intrinsics;
    const double focal_px = camera.optics.focal_length_m / camera.detector.pixel_pitch_m;
    if (find("projection", "fx_px") == nullptr) projection.fx_px = focal_px;
    if (find("projection", "fy_px") == nullptr) projection.fy_px = projection.fx_px;
    if (find("projection", "cx_px") == nullptr) projection.cx_px = 0.5 * (projection.width_px - 1);
    if (find("projection", "cy_px") == nullptr) projection.cy_px = 0.5 * (projection.height_px - 1);
    return camera;
  }

 private:
  const toml::node* find(const char* section, std::string_view name) const {
    const toml::table* table = *section == '\0' ? &root_ : root_[section].as_table();
    return table == nullptr ? nullptr : table->get(name);
  }

  std::string place(const toml::source_position& at) const {
    return fmt::format("{}:{}:{}", file_, at.line, at.column);
  }
  std::string place(const toml::node* node) const { return place(node->source().begin); }

  Result<void> check_keys() const {
    const std::set<std::string> known = known_keys();
    std::set<std::string, std::less<>> sections;
    for (const std::string& key : known) {
      if (const auto dot = key.find('.'); dot != std::string::npos) sections.insert(key.substr(0, dot));
    }
    const auto unknown = [&](const toml::key& key, const std::string& name) {
      return fail(ErrorCode::invalid_argument, "unknown key {s}", {}, place(key.source().begin),
                  fmt::format("\"{}\"; did you mean \"{}\"?", name, *nearest_word(name, known)));
    };
    for (const auto& [key, node] : root_) {
      const bool is_section = sections.contains(key.str());
      if (!is_section) {
        if (!known.contains(std::string(key.str()))) return unknown(key, std::string(key.str()));
        continue;
      }
      const toml::table* table = node.as_table();
      if (table == nullptr) {
        return fail(ErrorCode::invalid_argument, "{s} must be a section", {}, place(&node), key.str());
      }
      for (const auto& [inner, value] : *table) {
        const std::string name = full_name(key.str(), inner.str());
        if (!known.contains(name)) return unknown(inner, name);
      }
    }
    return {};
  }

  tl::unexpected<Error> missing(const char* section, std::string_view name) const {
    const toml::node* table = *section == '\0' ? nullptr : root_.get(section);
    return fail(ErrorCode::invalid_argument, "the key {s} is missing", {}, table == nullptr ? file_ : place(table),
                full_name(section, name));
  }

  Result<void> integer(const IntegerKey& key, Camera& camera) const {
    const toml::node* node = find(key.section, key.name);
    if (node == nullptr) return missing(key.section, key.name);
    const auto value = node->value_exact<std::int64_t>();
    if (!value || *value < key.min || *value > key.max) {
      return fail(ErrorCode::invalid_argument, "{s} must be a whole number from {0} to {1}",
                  {static_cast<double>(key.min), static_cast<double>(key.max)}, place(node),
                  full_name(key.section, key.name));
    }
    key.field(camera) = static_cast<int>(*value);
    return {};
  }

  static std::optional<double> as_number(const toml::node& node) {
    if (!node.is_number()) return {};
    return node.value<double>();
  }

  Result<void> number(const NumberKey& key, Camera& camera) const {
    const toml::node* node = find(key.section, key.name);
    if (node == nullptr) {
      if (key.need == Need::required) return missing(key.section, key.name);
      return {};
    }
    const auto value = as_number(*node);
    if (!value || !(*value >= key.min && *value <= key.max)) {
      return fail(ErrorCode::invalid_argument, "{s} must be a number from {0} to {1}", {key.min, key.max}, place(node),
                  full_name(key.section, key.name));
    }
    key.field(camera) = *value * key.to_si;
    return {};
  }

  Result<void> choice(const ChoiceKey& key, Camera& camera) const {
    const toml::node* node = find(key.section, key.name);
    if (node == nullptr) return {};
    std::optional<std::string> word = node->value_exact<std::string>();
    if (key.is_switch())
      word = node->is_boolean() ? std::optional(*node->value<bool>() ? "true" : "false") : std::nullopt;
    const auto found = word ? std::find(key.words.begin(), key.words.end(), *word) : key.words.end();
    if (found == key.words.end()) {
      return fail(
          ErrorCode::invalid_argument, "{s}", {}, place(node),
          fmt::format("{} must be {} or {}", full_name(key.section, key.name), key.text(false), key.text(true)));
    }
    key.set(camera, found != key.words.begin());
    return {};
  }

  // An image, beside the camera's file.
  Result<void> kernel(Camera& camera) const {
    const toml::node* node = find("psf", "kernel");
    if (node == nullptr) return {};
    const auto name = node->value_exact<std::string>();
    if (!name || name->empty()) {
      return fail(ErrorCode::invalid_argument, "psf.kernel must be the name of an image", {}, place(node));
    }
    const std::filesystem::path path = std::filesystem::path(file_).parent_path() / *name;
    const Result<Picture> picture = read_picture(path);
    if (!picture) return forward(picture);
    const ImageF& values = picture->pixels;
    PsfKernel& kernel = camera.psf.kernel;
    kernel.file = *name;
    kernel.width = values.width();
    kernel.height = values.height();
    double sum = 0.0;
    for (const float value : values.pixels()) {
      if (!(value >= 0.0f)) {
        return fail(ErrorCode::invalid_argument, "a point-spread function holds no negative light", {}, path.string());
      }
      sum += static_cast<double>(value);
    }
    if (!(sum > 0.0))
      return fail(ErrorCode::invalid_argument, "a point-spread function without light", {}, path.string());
    for (const float value : values.pixels()) kernel.values.push_back(static_cast<float>(value / sum));
    return {};
  }

  Result<std::vector<double>> list(const char* section, const std::string& name, double min, double max) const {
    const toml::node* node = find(section, name);
    if (node == nullptr) return missing(section, name);
    const auto bad = [&](const toml::node* where) {
      return fail(ErrorCode::invalid_argument, "{s} must be a list of two or more numbers from {0} to {1}", {min, max},
                  place(where), full_name(section, name));
    };
    const toml::array* array = node->as_array();
    if (array == nullptr || array->size() < 2) return bad(node);
    std::vector<double> values;
    for (const toml::node& element : *array) {
      const auto value = as_number(element);
      if (!value || !(*value >= min && *value <= max)) return bad(&element);
      values.push_back(*value);
    }
    return values;
  }

  Result<void> curve(const CurveKey& key, Camera& camera) const {
    const std::string wavelength_name = std::string(key.name) + "_wavelength_nm";
    const auto wavelengths = list(key.section, wavelength_name, 100.0, 20000.0);
    if (!wavelengths) return forward(wavelengths);
    const auto values = list(key.section, key.name, 0.0, 1.0);
    if (!values) return forward(values);
    const toml::node* node = find(key.section, wavelength_name);
    if (!std::is_sorted(wavelengths->begin(), wavelengths->end(), std::less_equal<>())) {
      return fail(ErrorCode::invalid_argument, "{s} must rise from one value to the next", {}, place(node),
                  full_name(key.section, wavelength_name));
    }
    if (wavelengths->size() != values->size()) {
      return fail(ErrorCode::invalid_argument, "{s} has {0} values for {1} wavelengths",
                  {static_cast<double>(values->size()), static_cast<double>(wavelengths->size())},
                  place(find(key.section, key.name)), full_name(key.section, key.name));
    }
    auto& points = key.field(camera);
    for (std::size_t i = 0; i < values->size(); ++i) points.push_back({(*wavelengths)[i] * 1e-9, (*values)[i]});
    return {};
  }

  const toml::table& root_;
  std::string file_;
};

// The shortest text that, times the unit, reads back to the same number.
std::string number_text(double si, double to_si) {
  std::string text;
  for (int digits = 15; digits <= 17; ++digits) {
    text = fmt::format("{:.{}g}", si / to_si, digits);
    if (std::strtod(text.c_str(), nullptr) * to_si == si) break;
  }
  return text.find_first_of(".en") == std::string::npos ? text + ".0" : text;
}

}  // namespace

Result<Camera> parse_camera(std::string_view toml, std::string_view name_for_errors) {
  const toml::parse_result parsed = toml::parse(toml, name_for_errors);
  if (!parsed) {
    const toml::source_position at = parsed.error().source().begin;
    return fail(ErrorCode::invalid_argument, "not valid TOML ({s})", {},
                fmt::format("{}:{}:{}", name_for_errors, at.line, at.column), parsed.error().description());
  }
  return Parser(parsed.table(), name_for_errors).camera();
}

Result<Camera> read_camera(const std::filesystem::path& path_or_name) {
  std::filesystem::path path = path_or_name;
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored) && !path.has_parent_path()) {
    const auto preset = home_directory() / "scenarios" / "cameras" / (path.string() + ".toml");
    if (std::filesystem::exists(preset, ignored)) path = preset;
  }
  const Result<MappedFile> file = MappedFile::open(path);
  if (!file) {
    if (file.error().code == ErrorCode::not_found) {
      return fail(ErrorCode::not_found, "no such camera file, nor a camera of that name in scenarios/cameras", {},
                  path_or_name.string());
    }
    return forward(file);
  }
  if (file->text().find_first_not_of(" \t\r\n") == std::string_view::npos)
    return fail(ErrorCode::invalid_argument, "the file is empty, where a camera in TOML was expected", {},
                path.string());
  Result<Camera> camera = parse_camera(file->text(), path.string());
  if (camera && camera->name.empty()) camera->name = path.stem().string();
  return camera;
}

std::string to_toml(const Camera& camera) {
  Camera copy = camera;
  std::string name;
  for (const char c : camera.name) {
    if (c == '"' || c == '\\') name += '\\';
    if (static_cast<unsigned char>(c) >= 0x20) name += c;
  }
  std::string out = fmt::format("name = \"{}\"\n", name);
  for (const char* section : {"", "image", "projection", "distortion", "optics", "psf", "detector"}) {
    if (*section != '\0') out += fmt::format("\n[{}]\n", section);
    for (const IntegerKey& key : kIntegers) {
      if (std::string_view(key.section) == section) out += fmt::format("{} = {}\n", key.name, key.field(copy));
    }
    for (const NumberKey& key : kNumbers) {
      if (std::string_view(key.section) != section) continue;
      out += fmt::format("{} = {}\n", key.name, number_text(key.field(copy), key.to_si));
    }
    for (const ChoiceKey& key : kChoices) {
      if (std::string_view(key.section) != section) continue;
      out += fmt::format("{} = {}\n", key.name, key.text(key.get(copy)));
    }
    if (std::string_view(section) == "psf" && !copy.psf.kernel.empty()) {
      out += fmt::format("kernel = \"{}\"\n", copy.psf.kernel.file);
    }
    for (const CurveKey& key : kCurves) {
      if (std::string_view(key.section) != section) continue;
      std::string wavelengths;
      std::string values;
      for (const BandPoint& point : key.field(copy)) {
        const char* comma = values.empty() ? "" : ", ";
        wavelengths += fmt::format("{}{}", comma, number_text(point.wavelength_m, 1e-9));
        values += fmt::format("{}{}", comma, number_text(point.value, 1.0));
      }
      out += fmt::format("{0}_wavelength_nm = [{1}]\n{0} = [{2}]\n", key.name, wavelengths, values);
    }
  }
  return out;
}

}  // namespace astronav
