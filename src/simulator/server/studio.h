// SPDX-License-Identifier: Apache-2.0
// Studio: takes the picture of a scene. Cameras made ready (detector maps, photometry) are kept and shared, the least
// recently used leave first.
#pragma once

#include <cstddef>
#include <limits>
#include <list>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "foundation/base/error.h"
#include "foundation/image/image.h"
#include "models/ephemeris/ephemeris.h"
#include "models/photometry/photometry.h"
#include "models/stars/catalogue.h"
#include "simulator/render/renderer.h"
#include "simulator/server/scene.h"
#include "simulator/sky/sky.h"

namespace astronav::server {

// A picture, and everything that its truth tells. Reused for the next picture: its buffers are kept.
struct Shot {
  std::shared_ptr<const Camera> camera;
  Epoch epoch;
  Epoch time_tag;  // what the camera's clock says of it
  State observer_O;
  Mat3 R_CN = Mat3::Identity();
  double exposure_s = 0.0;
  std::uint64_t seed = 1;
  PixelFormat format = PixelFormat::dn;
  std::vector<render::RenderedSource> sources;  // brightest first; some lie beside the detector
  ImageU16 dn;
  ImageF electrons;
  std::string png;
  std::span<const std::byte> pixels() const;  // as the format says
};
// The fields of `astronav render --truth`, without the image's name.
nlohmann::ordered_json truth(const Shot& shot);

class Studio {
 public:
  struct Room {  // what is kept at most
    std::size_t cameras = 8;
    std::size_t pixels = std::size_t{1} << 25;
    double scene_work = std::numeric_limits<double>::infinity();  // of a scene: render::painting_work
  };
  // Ephemeris and stars must outlive the studio.
  Studio(const Ephemeris& ephemeris, const StarCatalogue& stars, const Room& room)
      : ephemeris_(&ephemeris), sky_(ephemeris, stars), room_(room) {}

  // Safe to call from several threads; they wait for one another only where two want the same new camera.
  Result<void> take(const Scene& scene, Shot& shot) const;
  // What is around: stars to V 4.5, planets and the Sun in all directions, and the outline of the camera's field. Fills
  // the shot as take() does for a scene without a picture.
  Result<nlohmann::ordered_json> surroundings(const Scene& scene, Shot& shot) const;
  // Cameras made ready so far, those that have left included.
  std::size_t cameras_made() const;

 private:
  struct Ready {
    explicit Ready(const Scene& scene);
    std::shared_ptr<const Camera> camera;
    BandPhotometry band;
    render::Renderer renderer;
  };
  struct Place {
    std::string key;
    std::uint64_t detector_seed = 0;
    std::size_t pixels = 0;
    std::once_flag once;
    std::shared_ptr<const Ready> ready;
  };
  std::shared_ptr<const Ready> ready(const Scene& scene) const;
  Result<sky::SkySettings> sky_settings(const Scene& scene) const;
  Result<Mat3> attitude(const Scene& scene, const sky::SkySettings& settings, const State& observer_O) const;
  Result<void> check_work(const Scene& scene, const Shot& shot) const;

  const Ephemeris* ephemeris_;
  sky::Sky sky_;
  Room room_;
  mutable std::mutex mutex_;
  mutable std::list<std::shared_ptr<Place>> places_;  // the most recently used first
  mutable std::size_t made_ = 0;
};

}  // namespace astronav::server
