// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/cold_start.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "foundation/base/check.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/ephemeris/ecliptic.h"
#include "onboard/navigation/measurement_model.h"

namespace astronav::executive {
namespace {

constexpr double kOverlap = 0.9;      // of a picture's width, from one to the next
constexpr int kMostZeroPoints = 64;   // stars that tell a picture's magnitudes
constexpr double kStarFainter = 1.0;  // mag: a star so much fainter than a spot is not the spot
constexpr double kDiscShare = 0.25;   // of its radius a disc's centroid may be off its centre
constexpr double kDisagree = 1.0 - 1e-6;

// Of the ecliptic; longitudes count from the equinox, which is the x axis of N.
Vec3 direction_at(double longitude_rad) {
  const Vec3 equinox = Vec3::UnitX();
  return std::cos(longitude_rad) * equinox + std::sin(longitude_rad) * ecliptic_north_N().cross(equinox);
}
double longitude_of(const Vec3& direction_N) {
  const Vec3 equinox = Vec3::UnitX();
  return std::atan2(direction_N.dot(ecliptic_north_N().cross(equinox)), direction_N.dot(equinox));
}

double magnitude(double flux_dn) {
  return -2.5 * std::log10(flux_dn);
}

}  // namespace

ColdStart::ColdStart(const ColdStartSettings& settings, const Ephemeris& ephemeris, const vision::StarField* field)
    : settings_(settings),
      ephemeris_(&ephemeris),
      field_(field),
      half_gap_rad_(settings.sun_exclusion_rad + settings.sun_sensor_rad) {
  settings_.survey.sun_exclusion_rad = settings.sun_exclusion_rad;
  const double arc = 2.0 * (kPi - half_gap_rad_);
  const double width = kOverlap * settings.filter.camera.field_of_view_horizontal_rad();
  pictures_ = 1 + static_cast<int>(std::ceil(arc / width));
  step_rad_ = arc / (pictures_ - 1);
}

Result<void> ColdStart::begin_survey(const Vec3& to_sun_N) {
  if (pictures_ > static_cast<int>(navigation::kMaxSurveyFrames))
    return fail(ErrorCode::limit_exceeded, "a survey of the ecliptic takes {0} pictures with this camera; {1} at most",
                {static_cast<double>(pictures_), static_cast<double>(navigation::kMaxSurveyFrames)});
  sun_longitude_rad_ = longitude_of(to_sun_N);
  frame_count_ = spot_count_ = named_count_ = sight_count_ = 0;
  images_ = 0;
  bias_rad_ = 0.0;
  count_ = {};
  return {};
}

Duration ColdStart::picture_period() const {
  return Duration::seconds(navigation::slew_time_s(settings_.agility, step_rad_));
}

Mat3 ColdStart::picture_R_CN(int picture) const {
  const Vec3 z = direction_at(sun_longitude_rad_ + half_gap_rad_ + step_rad_ * picture);
  const Vec3 y = -ecliptic_north_N();  // downwards in the picture
  Mat3 R_CN;
  R_CN << y.cross(z).transpose(), y.transpose(), z.transpose();
  return R_CN;
}

navigation::SurveyFrame& ColdStart::begin_frame(const Mat3& R_CN, Epoch epoch) {
  ASTRONAV_CHECK(frame_count_ < frames_.size());
  navigation::SurveyFrame& frame = frames_[frame_count_++];
  frame = {.epoch = epoch, .R_CN = R_CN, .camera = settings_.filter.camera, .limit_v_mag = settings_.limit_v_mag};
  ++count_.solved;
  return frame;
}

// The brightest count: a brighter one takes the place of the faintest.
void ColdStart::keep(const navigation::SurveySpot& spot) {
  ++count_.spots;
  if (spot_count_ < spots_.size()) {
    spots_[spot_count_++] = spot;
    return;
  }
  const auto fainter = [](const auto& a, const auto& b) { return a.v_mag < b.v_mag; };
  const auto faintest = std::max_element(spots_.begin(), spots_.end(), fainter);
  if (spot.v_mag < faintest->v_mag) *faintest = spot;
}

int ColdStart::see(const vision::FrameResult& picture, Epoch mid_exposure) {
  ASTRONAV_CHECK(field_ != nullptr);
  ++count_.pictures;
  if (picture.source == vision::AttitudeSource::none || frame_count_ == frames_.size()) return 0;
  const vision::AttitudeSolution& attitude = picture.attitude;
  const double pixel_rad = attitude.intrinsics.plate_scale_rad_px();
  const double match_rad = settings_.match_px * pixel_rad;
  const auto direction_of = [&](const vision::Centroid& spot) -> Result<Vec3> {
    const Result<Vec3> in_camera = unproject(attitude.intrinsics, spot.pixel);
    if (!in_camera) return forward(in_camera);
    return Vec3(attitude.R_CN.transpose() * *in_camera);
  };

  // What magnitude a flux is, by the stars that did not saturate.
  std::array<double, kMostZeroPoints> zero_points{};
  std::size_t known = 0;
  for (const vision::MatchedStar& star : picture.stars) {
    const vision::Centroid& spot = picture.centroids[star.centroid];
    if (known == zero_points.size() || spot.saturated || !(spot.flux_dn > 0.0)) continue;
    const Result<Vec3> direction = direction_of(spot);
    const std::int32_t found = direction ? field_->nearest(*direction, match_rad) : -1;
    if (found < 0) continue;
    zero_points[known++] = field_->stars()[static_cast<std::size_t>(found)].v_mag - magnitude(spot.flux_dn);
  }
  if (known == 0) return 0;
  const auto middle = zero_points.begin() + static_cast<std::ptrdiff_t>(known / 2);
  std::nth_element(zero_points.begin(), middle, zero_points.begin() + static_cast<std::ptrdiff_t>(known));
  const double zero_point = *middle;

  begin_frame(attitude.R_CN, mid_exposure).camera = attitude.intrinsics;
  const double attitude_rad = std::sqrt(attitude.covariance_rad2.trace() / 3.0);
  int spots = 0;
  for (const vision::Centroid& spot : picture.centroids) {
    if (spot.kind != vision::SpotKind::point && spot.kind != vision::SpotKind::extended) continue;
    if (!(spot.flux_dn > 0.0)) continue;
    const double v_mag = zero_point + magnitude(spot.flux_dn);
    if (v_mag > settings_.limit_v_mag) continue;
    const Result<Vec3> direction = direction_of(spot);
    if (!direction || field_->nearest(*direction, match_rad, v_mag + kStarFainter) >= 0) continue;
    double sigma_px = std::hypot(std::sqrt(0.5 * spot.covariance_px2.trace()), spot.repeating_sigma_px);
    if (spot.kind == vision::SpotKind::extended)
      sigma_px = std::hypot(sigma_px, kDiscShare * std::sqrt(spot.pixels / kPi));
    const double sigma_rad = std::hypot(std::max(sigma_px, settings_.least_sigma_px) * pixel_rad, attitude_rad);
    keep({.frame = frame_count_ - 1, .direction_N = *direction, .sigma_rad = sigma_rad, .v_mag = v_mag});
    ++spots;
  }
  return spots;
}

void ColdStart::see_spots(const Mat3& R_CN, Epoch mid_exposure, std::span<const navigation::SurveySpot> spots) {
  ++count_.pictures;
  begin_frame(R_CN, mid_exposure);
  for (navigation::SurveySpot spot : spots) {
    if (spot.v_mag > settings_.limit_v_mag) continue;
    spot.frame = frame_count_ - 1;
    keep(spot);
  }
}

Result<navigation::InitialState> ColdStart::locate() {
  named_count_ = 0;
  if (frame_count_ == 0) return fail(ErrorCode::no_match, "no picture of the survey gave an attitude");
  const auto found =
      navigation::survey(*ephemeris_, {frames_.data(), frame_count_}, {spots_.data(), spot_count_}, settings_.survey);
  if (!found) return forward(found);
  place_ = *found;
  for (std::size_t i = 0; i < place_.count; ++i) {
    const auto end = named_.begin() + static_cast<std::ptrdiff_t>(named_count_);
    if (std::find(named_.begin(), end, place_.named[i].body) == end) named_[named_count_++] = place_.named[i].body;
  }
  const auto start = navigation::start_from_survey(*ephemeris_, place_);
  if (!start) return forward(start);
  start_ = *start;
  return navigation::InitialState{
      .epoch = start_.epoch, .state = start_.state, .covariance = start_.covariance, .mass_kg = settings_.mass_kg};
}

// What the law of the centre of light is wrong by, the same in all images of a window.
double ColdStart::photocentre_sigma_rad(BodyId body, Epoch epoch, double* ephemeris_sigma_m) const {
  const navigation::BeaconErrors errors = settings_.filter.errors_of(body);
  *ephemeris_sigma_m = std::hypot(errors.ephemeris_m, errors.lasting_ephemeris_m);
  const auto constants = body_constants(body);
  const auto id = ephemeris_->resolve(body);
  if (!(errors.photocentre_fraction > 0.0) || !constants || !id) return 0.0;
  const auto planet = ephemeris_->state(*id, body::solar_system_barycenter, epoch);
  const auto sun = ephemeris_->state(body::sun, body::solar_system_barycenter, epoch);
  if (!planet || !sun) return 0.0;
  const auto sight = navigation::apparent_sight(start_.state, *planet, sun->p_m, constants->mean_radius_m, {});
  return errors.photocentre_fraction * sight.shift_N.norm();
}

void ColdStart::add(const navigation::BeaconMeasurement& m) {
  // More than a batch holds: every so many-th, spread over both windows.
  const int stride = 1 + (2 * settings_.images_per_window - 1) / static_cast<int>(sights_.size());
  if (images_++ % stride != 0 || sight_count_ == sights_.size()) return;
  const Intrinsics& camera = settings_.filter.camera;
  const Result<Vec3> in_camera = unproject(camera, m.pixel);
  if (!in_camera) return;
  const double pixel_rad = camera.plate_scale_rad_px();
  navigation::BatchSight& out = sights_[sight_count_++];
  out = {};
  out.epoch = m.mid_exposure;
  out.sight.body = m.body;
  out.sight.direction_N = (m.R_CN.transpose() * *in_camera).normalized();
  // Pixels lie across the boresight, give or take the half field: a few per cent of a sigma.
  Mat3 covariance_C = m.attitude_covariance_rad2 - m.attitude_repeating_rad2;
  const Mat3 turn = cross_matrix(*in_camera);
  covariance_C = turn * covariance_C * turn.transpose();
  covariance_C.topLeftCorner<2, 2>() += m.pixel_covariance_px2 * pixel_rad * pixel_rad;
  out.sight.covariance_rad2 = m.R_CN.transpose() * covariance_C * m.R_CN;
  out.boresight_N = m.R_CN.row(2).transpose();
  out.v_stars_m_s = m.v_stars_m_s.value_or(start_.state.v_m_s);
  const double light_rad = photocentre_sigma_rad(m.body, m.mid_exposure, &out.sight.ephemeris_sigma_m);
  const double planet_rad = std::hypot(settings_.filter.bias.sigma, m.repeating_sigma_px) * pixel_rad;
  const double attitude_rad = std::sqrt(0.5 * (m.attitude_repeating_rad2(0, 0) + m.attitude_repeating_rad2(1, 1)));
  bias_rad_ = std::max(bias_rad_, std::hypot(planet_rad, attitude_rad, light_rad));
}

Result<navigation::InitialState> ColdStart::solve() {
  const std::span<const navigation::BatchSight> sights(sights_.data(), sight_count_);
  const bool two = std::any_of(sights.begin(), sights.end(),
                               [&](const auto& s) { return s.sight.body != sights.front().sight.body; });
  if (!two) return fail(ErrorCode::no_match, "a start from nothing needs sights of two planets");
  navigation::BatchSettings batch;
  batch.process = settings_.filter.process;
  batch.sight = settings_.filter.sight;
  batch.mass_kg = settings_.mass_kg;
  // The batch has no scale of solar pressure; a mass that is off does the same.
  batch.mass_sigma_kg = settings_.filter.process.solar_pressure.sigma * settings_.mass_kg;
  batch.bias = {.sigma = bias_rad_, .tau_s = settings_.filter.bias.tau_s};
  batch.window_gap = settings_.filter.window_gap;
  batch.gate_probability = settings_.filter.gate_probability;
  const auto solved = navigation::solve_batch(*ephemeris_, sights, start_, batch);
  if (!solved) return forward(solved);

  // The survey's place is in the batch, but three numbers do not stand out among those of a hundred sights.
  const Vec3 moved = start_.state.v_m_s * (solved->epoch - start_.epoch).seconds();
  const double seconds = (solved->epoch - start_.epoch).seconds();
  const Mat3 covariance = start_.covariance.topLeftCorner<3, 3>() +
                          start_.covariance.bottomRightCorner<3, 3>() * seconds * seconds +
                          solved->covariance.topLeftCorner<3, 3>();
  const Vec3 off = solved->state.p_m - (start_.state.p_m + moved);
  if (off.dot(covariance.ldlt().solve(off)) > chi_square_quantile(kDisagree, 3.0))
    return fail(ErrorCode::no_match, "the two windows put the spacecraft {0} km away from where the survey saw it",
                {off.norm() * 1e-3});
  navigation::InitialState initial = navigation::initial_state(*solved, batch);
  initial.mass_sigma_kg = 0.0;  // the filter has the scale of solar pressure itself
  return initial;
}

}  // namespace astronav::executive
