// SPDX-License-Identifier: Apache-2.0
#include "cli/inputs.h"

#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include "models/ephemeris/ground.h"
#include "models/oem/oem.h"
#include "simulator/trajectory/trajectory.h"

namespace astronav::cli {
namespace {

constexpr std::size_t kMaxEpochs = 1'000'000;
constexpr std::string_view kGround = "ground:";
constexpr double kMaxDistanceKm = 1e12;  // 6700 au

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

Result<Observer> fixed_observer(std::string_view text) {
  const auto n = parse_numbers(text, 3, 6, "ssb:X,Y,Z[,VX,VY,VZ] in km and km/s");
  if (!n) return forward(n, "--observer");
  if (n->size() != 3 && n->size() != 6)
    return fail(ErrorCode::invalid_argument, "'ssb:{s}' has {0} numbers: X,Y,Z or X,Y,Z,VX,VY,VZ are read",
                {static_cast<double>(n->size()), 0, 0, 0}, "--observer", text);
  State state;
  state.p_m = 1e3 * Vec3((*n)[0], (*n)[1], (*n)[2]);
  if (n->size() == 6) state.v_m_s = 1e3 * Vec3((*n)[3], (*n)[4], (*n)[5]);
  if (state.p_m.norm() > 1e3 * kMaxDistanceKm)
    return fail(ErrorCode::out_of_range, "'ssb:{s}' is farther than {0} km", {kMaxDistanceKm, 0, 0, 0}, "--observer",
                text);
  if (state.v_m_s.norm() >= kSpeedOfLight)
    return fail(ErrorCode::out_of_range, "'ssb:{s}' is not slower than light", {}, "--observer", text);
  return [state](Epoch) -> Result<State> { return state; };
}

Result<Observer> ground_observer(const GroundSite& site, std::shared_ptr<const Kernels> kernels) {
  return [site, kernels = std::move(kernels)](Epoch epoch) -> Result<State> {
    auto state = kernels->ephemeris.state(body::earth, body::solar_system_barycenter, epoch);
    if (!state) return forward(state);
    const State site_state = ground_state(site, epoch);
    state->p_m += site_state.p_m;
    state->v_m_s += site_state.v_m_s;
    return state;
  };
}

Observer body_observer(BodyId id, std::shared_ptr<const Kernels> kernels) {
  return [id, kernels = std::move(kernels)](Epoch epoch) {
    return kernels->ephemeris.state(id, body::solar_system_barycenter, epoch);
  };
}

// The file comes on top of the kernels that are there: a spacecraft's SPK seldom holds the way to the barycentre.
Result<Observer> spk_observer(std::string_view text, const Kernels& kernels) {
  const std::size_t at = text.find('@');
  if (at == std::string_view::npos || at + 1 == text.size())
    return fail(ErrorCode::invalid_argument, "'spk:{s}' is not an observer: expected spk:ID@FILE", {}, "--observer",
                text);
  const auto id = parse_body(text.substr(0, at));
  if (!id) return forward(id, "--observer");
  std::vector<std::string> paths;
  for (const MappedFile& file : kernels.files) paths.push_back(file.path().string());
  paths.emplace_back(text.substr(at + 1));
  const auto opened = open_kernels(paths);
  if (!opened) return forward(opened);
  const auto held = (*opened)->ephemeris.resolve(*id);
  if (!held) return forward(held, paths.back());
  return body_observer(*held, *opened);
}

Result<Observer> oem_observer(std::string_view path, std::shared_ptr<const Kernels> kernels) {
  if (path.empty())
    return fail(ErrorCode::invalid_argument, "'oem:' is not an observer: expected oem:FILE", {}, "--observer");
  const auto file = MappedFile::open(std::filesystem::path(path));
  if (!file) return forward(file, path);
  const auto oem = parse_oem(file->text(), path);
  if (!oem) return forward(oem, path);
  const auto trajectory = trajectory::from_oem(*oem, &kernels->ephemeris);
  if (!trajectory) return forward(trajectory, path);
  return [trajectory = *trajectory, kernels = std::move(kernels)](Epoch epoch) { return trajectory->state(epoch); };
}

Result<std::shared_ptr<const Kernels>> open_files(const std::vector<std::filesystem::path>& files) {
  auto kernels = std::make_shared<Kernels>();
  std::vector<std::span<const std::byte>> bytes;
  for (const auto& path : files) {
    auto file = MappedFile::open(path);
    if (!file) return forward(file, path.string());
    // Each by itself first, so that an error names its file.
    const auto alone = Ephemeris::open(file->bytes());
    if (!alone) return forward(alone, path.string());
    bytes.push_back(file->bytes());
    kernels->files.push_back(std::move(*file));
  }
  auto ephemeris = Ephemeris::open(bytes);
  if (!ephemeris) return forward(ephemeris);
  kernels->ephemeris = std::move(*ephemeris);
  return kernels;
}

}  // namespace

Result<std::shared_ptr<const Kernels>> open_kernels(std::span<const std::string> paths) {
  if (paths.empty()) return open_kernels_above_shipped({});
  return open_files({paths.begin(), paths.end()});
}

Result<std::shared_ptr<const Kernels>> open_kernels_above_shipped(std::span<const std::string> paths) {
  std::vector<std::filesystem::path> files{home_directory() / "data" / "de405_2000_2050.bsp"};
  files.insert(files.end(), paths.begin(), paths.end());
  return open_files(files);
}

Result<std::shared_ptr<const Kernels>> open_kernels_for(std::span<const std::string> paths,
                                                        std::initializer_list<BodyId> bodies, Epoch epoch) {
  auto named = open_kernels(paths);
  if (!named || paths.empty()) return named;
  for (const BodyId id : bodies) {
    const auto held = (*named)->ephemeris.resolve(id);
    const auto state = held ? (*named)->ephemeris.state(*held, body::solar_system_barycenter, epoch) : State{};
    if (!held || (!state && state.error().code == ErrorCode::not_found)) return open_kernels_above_shipped(paths);
  }
  return named;
}

Result<OpenCatalogue> open_catalogue(const std::string& path) {
  const std::filesystem::path chosen =
      path.empty() ? home_directory() / "data/hipparcos.stars" : std::filesystem::path(path);
  auto file = MappedFile::open(chosen);
  if (!file) return forward(file, chosen.string());
  auto stars = StarCatalogue::open(file->bytes());
  if (!stars) return forward(stars, chosen.string());
  return OpenCatalogue{std::move(*file), *stars};
}

Result<std::optional<GroundSite>> parse_ground_site(std::string_view text) {
  text = trimmed(text);
  if (!text.starts_with(kGround)) return std::optional<GroundSite>();
  const auto n = parse_numbers(text.substr(kGround.size()), 3, 3, "ground:LAT,LON,HEIGHT_M in degrees and metres");
  if (!n) return forward(n, "--observer");
  if (std::abs((*n)[0]) > 90.0)
    return fail(ErrorCode::out_of_range, "the latitude {0} is not in -90 to 90 degrees", {(*n)[0], 0, 0, 0},
                "--observer");
  if (std::abs((*n)[1]) > 360.0)
    return fail(ErrorCode::out_of_range, "the longitude {0} is not in -360 to 360 degrees", {(*n)[1], 0, 0, 0},
                "--observer");
  if (std::abs((*n)[2]) > 1e6)
    return fail(ErrorCode::out_of_range, "the height {0} m is not in -1e6 to 1e6", {(*n)[2], 0, 0, 0}, "--observer");
  return GroundSite{(*n)[0] * kDegree, (*n)[1] * kDegree, (*n)[2]};
}

Result<std::optional<Air>> parse_air(std::string_view observer, Epoch epoch) {
  const auto site = parse_ground_site(observer);
  if (!site) return forward(site);
  if (!*site) return std::optional<Air>();
  // Barometric formula of an atmosphere at 10 C: scale height 8.3 km.
  const double pressure_hpa = 1013.25 * std::exp(-(*site)->height_m / 8300.0);
  const Vec3 zenith = ground_zenith(**site, epoch);
  return Air{zenith, Refraction({.pressure_hpa = pressure_hpa}, zenith)};
}

Result<std::optional<std::string>> daylight_warning(std::string_view observer, Epoch epoch,
                                                    const Ephemeris& ephemeris) {
  const auto air = parse_air(observer, epoch);
  if (!air) return forward(air);
  if (!*air) return std::optional<std::string>();
  const auto sun = ephemeris.state(body::sun, body::earth, epoch);
  if (!sun) return forward(sun);
  const double altitude_rad = 0.5 * kPi - angle_between((*air)->zenith_N, sun->p_m);
  if (altitude_rad < 0.0) return std::optional<std::string>();
  return std::optional(fmt::format("the Sun stands {:.0f} degrees high for this --observer at this --epoch: is it UTC?",
                                   altitude_rad / kDegree));
}

Result<Observer> parse_observer(std::string_view text, std::shared_ptr<const Kernels> kernels) {
  text = trimmed(text);
  const auto rest_after = [&](std::string_view prefix) { return text.substr(prefix.size()); };
  if (text.starts_with("ssb:")) return fixed_observer(rest_after("ssb:"));
  const auto site = parse_ground_site(text);
  if (!site) return forward(site);
  if (*site) return ground_observer(**site, std::move(kernels));
  if (text.starts_with("spk:")) return spk_observer(rest_after("spk:"), *kernels);
  if (text.starts_with("oem:")) return oem_observer(rest_after("oem:"), std::move(kernels));
  const auto id = parse_body(text);
  if (!id) {
    return fail(ErrorCode::invalid_argument,
                "'{s}' is not an observer: expected ssb:X,Y,Z[,VX,VY,VZ], ground:LAT,LON,HEIGHT_M, spk:ID@FILE, "
                "oem:FILE or the name of a body",
                {}, "--observer", text);
  }
  const auto held = kernels->ephemeris.resolve(*id);
  if (!held) return forward(held, "--observer");
  return body_observer(*held, std::move(kernels));
}

Result<Pointing> parse_pointing(std::string_view text) {
  const auto n = parse_numbers(text, 3, 3, "RA,DEC,ROLL in degrees");
  if (!n) return forward(n, "--pointing");
  if (std::abs((*n)[0]) > 360.0 || std::abs((*n)[1]) > 90.0 || std::abs((*n)[2]) > 360.0)
    return fail(ErrorCode::out_of_range,
                "'{s}' is not a pointing: RA and roll lie in -360 to 360 degrees, Dec in -90 to 90", {}, "--pointing",
                text);
  return Pointing{(*n)[0] * kDegree, (*n)[1] * kDegree, (*n)[2] * kDegree};
}

Result<std::vector<Epoch>> parse_epochs(std::span<const std::string> texts) {
  std::vector<Epoch> out;
  for (const std::string& text : texts) {
    const std::size_t first = text.find('/');
    if (first == std::string::npos) {
      const auto epoch = Epoch::parse(text);
      if (!epoch) return forward(epoch, "--epoch");
      out.push_back(*epoch);
      continue;
    }
    const std::size_t second = text.find('/', first + 1);
    if (second == std::string::npos || text.find('/', second + 1) != std::string::npos)
      return fail(ErrorCode::invalid_argument, "'{s}' is not a range of epochs: expected START/STOP/STEP", {},
                  "--epoch", text);
    const auto start = Epoch::parse(std::string_view(text).substr(0, first));
    if (!start) return forward(start, "--epoch");
    const auto stop = Epoch::parse(std::string_view(text).substr(first + 1, second - first - 1));
    if (!stop) return forward(stop, "--epoch");
    const auto step = parse_duration(std::string_view(text).substr(second + 1));
    if (!step) return forward(step, "--epoch");
    if (step->nanoseconds() <= 0)
      return fail(ErrorCode::invalid_argument, "'{s}': the step must be longer than nothing", {}, "--epoch", text);
    if (*stop < *start)
      return fail(ErrorCode::invalid_argument, "'{s}': the range ends before it begins", {}, "--epoch", text);
    // Counted first: beyond the limit nothing may be filled in, nor may the sum overflow.
    const double count = std::floor((*stop - *start).seconds() / step->seconds()) + 1.0;
    if (count > static_cast<double>(kMaxEpochs - out.size()))
      return fail(ErrorCode::limit_exceeded, "'{s}' asks for {0} epochs; at most {1} are given at once",
                  {count, kMaxEpochs, 0, 0}, "--epoch", text);
    for (Epoch epoch = *start; epoch <= *stop; epoch = epoch + *step) out.push_back(epoch);
  }
  return out;
}

Result<std::vector<double>> parse_numbers(std::string_view text, std::size_t min_count, std::size_t max_count,
                                          std::string_view what) {
  std::vector<double> out;
  const auto wrong = [&] {
    return fail(ErrorCode::invalid_argument, "{s}", {}, {}, fmt::format("'{}' is not {}", text.substr(0, 80), what));
  };
  std::string_view rest = text;
  while (true) {
    const std::size_t comma = rest.find(',');
    std::string_view item = trimmed(rest.substr(0, comma));
    if (item.starts_with('+')) item.remove_prefix(1);
    double value = 0.0;
    const auto [end, error] = std::from_chars(item.data(), item.data() + item.size(), value);
    if (error != std::errc() || end != item.data() + item.size() || !std::isfinite(value)) return wrong();
    out.push_back(value);
    if (out.size() > max_count) return wrong();
    if (comma == std::string_view::npos) break;
    rest.remove_prefix(comma + 1);
  }
  if (out.size() < min_count) return wrong();
  return out;
}

}  // namespace astronav::cli
