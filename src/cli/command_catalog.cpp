// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "models/stars/catalogue.h"
#include "models/stars/tables.h"
#include "models/stars/writer.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string catalogue;
  std::string cone;
  double max_v = std::numeric_limits<double>::infinity();
  std::vector<std::string> tables;
  std::string out;
  std::string source;
  bool json = false;
};

Json number_or_null(double v) {
  return std::isnan(v) ? Json(nullptr) : Json(v);
}

// Floats carry thousandths of a magnitude; as doubles they would print their rounding.
double thousandths(float mag) {
  return std::round(static_cast<double>(mag) * 1000.0) / 1000.0;
}

Result<int> info(const Options& options) {
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  const StarCatalogue& stars = catalogue->stars;
  std::vector<float> magnitudes;
  std::size_t without_colour = 0;
  for (std::size_t i = 0; i < stars.size(); ++i) {
    const Star star = stars.star(i);
    magnitudes.push_back(star.v_mag);
    if (std::isnan(star.b_v)) ++without_colour;
  }
  std::sort(magnitudes.begin(), magnitudes.end());
  const auto down_to = [&](double v) {
    const auto end = std::upper_bound(magnitudes.begin(), magnitudes.end(), static_cast<float>(v));
    return end - magnitudes.begin();
  };
  const std::string path = catalogue->file.path().string();
  if (options.json) {
    Json out;
    out["file"] = path;
    out["source"] = stars.source();
    out["size_bytes"] = catalogue->file.bytes().size();
    out["epoch"] = "J2000.0";
    out["stars"] = stars.size();
    out["stars_without_colour"] = without_colour;
    out["v_mag_min"] = magnitudes.empty() ? Json(nullptr) : Json(thousandths(magnitudes.front()));
    out["v_mag_max"] = magnitudes.empty() ? Json(nullptr) : Json(thousandths(magnitudes.back()));
    for (int v = 1; v <= 12; ++v) out["stars_to_v_mag"].push_back({{"v_mag", v}, {"stars", down_to(v)}});
    fmt::print("{}\n", out.dump());
    return 0;
  }
  fmt::print("{}\n{}, {} stars at J2000.0 (ICRS), {} bytes, {} stars without a colour\n", path, stars.source(),
             stars.size(), catalogue->file.bytes().size(), without_colour);
  if (magnitudes.empty()) return 0;
  fmt::print("V from {:.2f} to {:.2f}\n", magnitudes.front(), magnitudes.back());
  for (int v = 1; v <= 12; ++v) fmt::print("  to V {:>2}  {:>8} stars\n", v, down_to(v));
  return 0;
}

void print_json(const Star& star, double separation_rad) {
  const RaDec place = radec_from_direction(star.direction_N);
  Json out;
  out["id"] = star.id;
  out["ra_deg"] = place.ra_rad / kDegree;
  out["dec_deg"] = place.dec_rad / kDegree;
  out["pm_ra_cosdec_mas_yr"] = star.pm_ra_cosdec_rad_yr / kMilliarcsecond;
  out["pm_dec_mas_yr"] = star.pm_dec_rad_yr / kMilliarcsecond;
  out["parallax_mas"] = star.parallax_rad / kMilliarcsecond;
  out["v_mag"] = thousandths(star.v_mag);
  out["b_v_mag"] = number_or_null(thousandths(star.b_v));
  out["separation_deg"] = separation_rad / kDegree;
  fmt::print("{}\n", out.dump());
}

void print_row(const Star& star, double separation_rad) {
  const RaDec place = radec_from_direction(star.direction_N);
  fmt::print("{:>10} {:>12.7f} {:>12.7f} {:>7.3f} {:>7} {:>10.2f} {:>10.2f} {:>9.2f} {:>10.4f}\n", star.id,
             place.ra_rad / kDegree, place.dec_rad / kDegree, star.v_mag,
             std::isnan(star.b_v) ? "-" : fmt::format("{:.3f}", star.b_v), star.pm_ra_cosdec_rad_yr / kMilliarcsecond,
             star.pm_dec_rad_yr / kMilliarcsecond, star.parallax_rad / kMilliarcsecond, separation_rad / kDegree);
}

Result<int> cone(const Options& options) {
  const auto numbers = parse_numbers(options.cone, 3, 3, "RA,DEC,RADIUS");
  if (!numbers) return forward(numbers);
  const double dec_deg = (*numbers)[1];
  const double radius_deg = (*numbers)[2];
  if (std::abs(dec_deg) > 90.0 || radius_deg < 0.0 || radius_deg > 180.0) {
    return fail(ErrorCode::invalid_argument,
                "'{s}' is no RA,DEC,RADIUS: declination lies between -90 and 90 degrees, the radius between 0 and 180",
                {}, {}, options.cone);
  }
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  const StarCatalogue& stars = catalogue->stars;
  const Vec3 center = direction_from_radec((*numbers)[0] * kDegree, dec_deg * kDegree);
  std::vector<std::uint32_t> found(stars.size());
  found.resize(stars.cone(center, radius_deg * kDegree, options.max_v, found));
  std::sort(found.begin(), found.end(), [&](std::uint32_t a, std::uint32_t b) {
    const Star one = stars.star(a);
    const Star other = stars.star(b);
    return one.v_mag != other.v_mag ? one.v_mag < other.v_mag : one.id < other.id;
  });
  if (!options.json) {
    fmt::print("{} stars, J2000.0 (ICRS), degrees, mas, mas/yr\n", found.size());
    fmt::print("{:>10} {:>12} {:>12} {:>7} {:>7} {:>10} {:>10} {:>9} {:>10}\n", "id", "RA", "Dec", "V", "B-V",
               "pm RA cosD", "pm Dec", "parallax", "separation");
  }
  for (const std::uint32_t index : found) {
    const Star star = stars.star(index);
    const double separation = angle_between(center, star.direction_N);
    options.json ? print_json(star, separation) : print_row(star, separation);
  }
  return 0;
}

Result<int> import_tables(const Options& options) {
  std::vector<StarTable> tables;
  std::string source;
  for (const std::string& path : options.tables) {
    const auto file = MappedFile::open(path);
    if (!file) return forward(file, path);
    auto table = read_star_table(file->bytes());
    if (!table) {
      // "line 12" alone would not say of which file.
      Error error = table.error();
      error.where = fmt::format("{}{}{}", path, error.where.empty() ? "" : ": ", error.where.view());
      return tl::unexpected<Error>(error);
    }
    if (source.find(name(table->kind)) == std::string::npos) {
      source += (source.empty() ? "" : ", ") + std::string(name(table->kind));
    }
    if (options.json) {
      fmt::print(
          "{}\n",
          Json{{"file", path}, {"kind", name(table->kind)}, {"stars", table->stars.size()}, {"skipped", table->skipped}}
              .dump());
    } else {
      fmt::print("{}: {}, {} stars, {} lines skipped (no place or no magnitude)\n", path, name(table->kind),
                 table->stars.size(), table->skipped);
    }
    tables.push_back(std::move(*table));
  }
  const auto index = [](const StarTable& t) { return t.kind == StarTableKind::tycho2_index; };
  if (std::all_of(tables.begin(), tables.end(), index)) {
    // An index knows neither the bright stars nor any motion.
    const auto shipped = open_catalogue({});
    if (!shipped) return forward(shipped);
    auto table = read_star_table(shipped->file.bytes());
    if (!table) return forward(table, shipped->file.path().string());
    tables.push_back(std::move(*table));
    source = "Hipparcos, " + source;
  }
  std::vector<Star> stars = merge_star_tables(tables);
  std::erase_if(stars, [&](const Star& star) { return static_cast<double>(star.v_mag) > options.max_v + 1e-6; });
  const auto bytes = write_star_catalogue(stars, options.source.empty() ? source : options.source);
  if (!bytes) return forward(bytes);
  if (const auto written = write_file(options.out, *bytes); !written) return forward(written, options.out);
  if (options.json) {
    fmt::print("{}\n", Json{{"out", options.out}, {"stars", stars.size()}, {"size_bytes", bytes->size()}}.dump());
  } else {
    fmt::print("{}: {} stars, {} bytes\n", options.out, stars.size(), bytes->size());
  }
  return 0;
}

}  // namespace

void add_catalog(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("catalog", "the star catalogue: what is in it, cone search, import");
  sub->require_subcommand(1);
  sub->footer("Example:\n  astronav catalog cone 83.8,-5.4,3 --max-v 6");

  CLI::App* info_sub = sub->add_subcommand("info", "how many stars, how bright");
  info_sub->footer("Example:\n  astronav catalog info");
  CLI::App* cone_sub = sub->add_subcommand("cone", "the stars around a direction, the brightest first");
  cone_sub->footer("Example:\n  astronav catalog cone 83.8,-5.4,3 --max-v 6 --json");
  cone_sub->add_option("cone", options->cone, "RA,DEC,RADIUS in degrees (ICRS)")->required();
  cone_sub->add_option("--max-v", options->max_v, "faintest V magnitude (default: all)")
      ->check(number_within(-30.0, 50.0));
  for (CLI::App* each : {info_sub, cone_sub}) {
    each->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  }
  CLI::App* import_sub = sub->add_subcommand("import", "makes a catalogue file from published tables");
  import_sub->footer(
      "Reads the Hipparcos main table (I/239, hip_main.dat) and Tycho-2 (I/259, tyc2.dat), plain or .gz,\n"
      "catalogue files, and the index files of Debian's astrometry-data-tycho2 packages, which go below\n"
      "the catalogue that is shipped. Tycho-2 stars that are in Hipparcos, too, are left out.\n"
      "Example:\n  astronav catalog import /usr/share/astrometry/index-tycho2-07.littleendian.fits --max-v 11 --out "
      "deep.stars");
  import_sub->add_option("tables", options->tables, "the tables")->required();
  import_sub->add_option("--out", options->out, "catalogue file to write")->required();
  import_sub->add_option("--max-v", options->max_v, "faintest V magnitude (default: all)")
      ->check(number_within(-30.0, 50.0));
  import_sub->add_option("--source", options->source, "text for the file's header, at most 32 bytes");
  for (CLI::App* each : {info_sub, cone_sub, import_sub}) {
    each->add_flag("--json", options->json, "one JSON object a line");
  }
  info_sub->callback([options, &invocation] { invocation.action = [options] { return info(*options); }; });
  cone_sub->callback([options, &invocation] { invocation.action = [options] { return cone(*options); }; });
  import_sub->callback([options, &invocation] { invocation.action = [options] { return import_tables(*options); }; });
}

}  // namespace astronav::cli
