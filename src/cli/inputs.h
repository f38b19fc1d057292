// SPDX-License-Identifier: Apache-2.0
// What several commands read from their arguments: kernels, epochs, observers, pointings.
#pragma once

#include <functional>
#include <initializer_list>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/ephemeris/ground.h"
#include "models/ephemeris/refraction.h"
#include "models/stars/catalogue.h"

namespace astronav::cli {

// SPK files mapped into memory, and the ephemeris that reads from them.
struct Kernels {
  std::vector<MappedFile> files;
  Ephemeris ephemeris;
};
// The files named (later ones take precedence), or the one that ships with the program where none is named. An error
// carries the path.
Result<std::shared_ptr<const Kernels>> open_kernels(std::span<const std::string> paths = {});
// The files named, and beneath them the one that ships with the program.
Result<std::shared_ptr<const Kernels>> open_kernels_above_shipped(std::span<const std::string> paths);
// The files named; where they alone do not lead from a body to the barycentre at the epoch (an asteroid's or a
// spacecraft's kernel seldom does), the same above the one that ships with the program.
Result<std::shared_ptr<const Kernels>> open_kernels_for(std::span<const std::string> paths,
                                                        std::initializer_list<BodyId> bodies, Epoch epoch);

// A star catalogue mapped into memory; the stars live as long as the file.
struct OpenCatalogue {
  MappedFile file;
  StarCatalogue stars;
};
// The file named, or the one that ships with the program where the path is empty. An error carries the path.
Result<OpenCatalogue> open_catalogue(const std::string& path);

// Barycentric state of an observer at an epoch (N, metres).
using Observer = std::function<Result<State>(Epoch)>;
// `ssb:X,Y,Z[,VX,VY,VZ]` (km, km/s; at rest without velocity), `ground:LAT,LON,HEIGHT_M` (degrees, east positive),
// `spk:ID@FILE`, `oem:FILE`, or the name or NAIF number of a body. Files are opened here; the observer keeps them.
Result<Observer> parse_observer(std::string_view text, std::shared_ptr<const Kernels> kernels);

// The place where the text is `ground:LAT,LON,HEIGHT_M`, nothing where it is another kind of observer.
Result<std::optional<GroundSite>> parse_ground_site(std::string_view text);

// The air above an observer `ground:LAT,LON,HEIGHT_M` (10 C, half as moist as it could be, pressure by its height);
// nothing above another.
struct Air {
  Vec3 zenith_N;
  Refraction refraction;
};
Result<std::optional<Air>> parse_air(std::string_view observer, Epoch epoch);

// What a user should hear who says that a picture of stars was taken where and when the Sun is up: an hour of another
// time zone, mostly. Nothing where all is well, or the observer does not stand on the ground.
Result<std::optional<std::string>> daylight_warning(std::string_view observer, Epoch epoch, const Ephemeris& ephemeris);

// `RA,DEC,ROLL` in degrees.
Result<Pointing> parse_pointing(std::string_view text);

// Each text is an epoch or `START/STOP/STEP` (STOP included where the steps hit it); at most a million epochs in all.
Result<std::vector<Epoch>> parse_epochs(std::span<const std::string> texts);

// Comma-separated finite numbers, between `min_count` and `max_count` of them; `what` says what they are in the error
// ("RA,DEC,ROLL").
Result<std::vector<double>> parse_numbers(std::string_view text, std::size_t min_count, std::size_t max_count,
                                          std::string_view what);

}  // namespace astronav::cli
