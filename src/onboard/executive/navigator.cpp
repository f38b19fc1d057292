// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/navigator.h"

#include <span>

#include "foundation/base/check.h"

namespace astronav::executive {

Navigator::Navigator(const NavigatorSettings& settings, const Ephemeris& ephemeris, vision::Vision* eyes)
    : settings_(settings), ephemeris_(&ephemeris), eyes_(eyes), filter_(settings.filter, ephemeris) {}

Result<void> Navigator::start(const navigation::InitialState& initial) { return filter_.initialise(initial); }

Result<void> Navigator::coast_to(Epoch epoch) { return filter_.propagate_to(epoch); }

Result<navigation::BeaconSelection> Navigator::select() const {
  return navigation::select_beacons(*ephemeris_, filter_.state(), filter_.epoch(), settings_.beacons);
}

Result<Vec3> Navigator::aim(BodyId body, Epoch epoch) {
  if (const auto ok = filter_.propagate_to(epoch); !ok) return forward(ok);
  const auto predicted = filter_.predict_direction(body);
  if (!predicted) return forward(predicted);
  return predicted->direction_N;
}

Result<Look> Navigator::look(ImageView<const std::uint16_t> frame, Epoch mid_exposure, BodyId beacon) {
  ASTRONAV_CHECK(eyes_ != nullptr);
  if (const auto ok = filter_.propagate_to(mid_exposure); !ok) return forward(ok);
  const auto predicted = filter_.predict_direction(beacon);
  if (!predicted) return forward(predicted);

  Look look;
  look.prediction.body = beacon;
  look.prediction.direction_N = predicted->direction_N;
  look.prediction.direction_covariance = predicted->covariance;
  const State here = filter_.state();
  const vision::Observer observer{.epoch = mid_exposure, .p_O_N = here.p_m, .v_O_N = here.v_m_s};
  const vision::FrameResult& seen = eyes_->process(frame, observer, {}, std::span(&look.prediction, 1));
  look.frame = &seen;
  look.measured = seen.source != vision::AttitudeSource::none && seen.planets[0].found;
  if (!look.measured) return look;

  const vision::Centroid& spot = seen.centroids[seen.planets[0].centroid];
  look.measurement.body = beacon;
  look.measurement.mid_exposure = mid_exposure;
  look.measurement.pixel = spot.pixel;
  look.measurement.pixel_covariance_px2 = spot.covariance_px2;
  look.measurement.R_CN = seen.attitude.R_CN;
  look.measurement.attitude_covariance_rad2 = seen.attitude.covariance_rad2;
  look.update = filter_.update(look.measurement);
  return look;
}

}  // namespace astronav::executive
