// SPDX-License-Identifier: Apache-2.0
#include "simulator/sky/sky.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"
#include "support/shared_data.h"

namespace astronav::sky {
namespace {

Camera any_camera() {
  Camera camera;
  camera.intrinsics = Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
  camera.optics = {.focal_length_m = 0.04, .pupil_diameter_m = 0.01818, .transmission = {{450e-9, 0.7}, {900e-9, 0.7}}};
  camera.detector.quantum_efficiency = {{450e-9, 0.7}, {900e-9, 0.7}};
  return camera;
}

class SkyTest : public ::testing::Test {
 protected:
  SkyTest()
      : kernel_(*MappedFile::open(home_directory() / "data" / "de405_2000_2050.bsp")),
        stars_(*MappedFile::open(home_directory() / "data" / "hipparcos.stars")),
        ephemeris_(*Ephemeris::open(kernel_.bytes())),
        catalogue_(*StarCatalogue::open(stars_.bytes())),
        sky_(ephemeris_, catalogue_),
        band_(any_camera()) {}

  State earth() const { return *ephemeris_.state(body::earth, body::solar_system_barycenter, epoch_); }
  const SkySource* find(const std::vector<SkySource>& sources, SourceKind kind, std::int64_t id) const {
    const auto it =
        std::find_if(sources.begin(), sources.end(), [&](const SkySource& s) { return s.kind == kind && s.id == id; });
    return it == sources.end() ? nullptr : &*it;
  }
  std::vector<SkySource> all_sky(const State& observer, const SkySettings& settings) const {
    return *sky_.look(epoch_, observer, Vec3::UnitX(), kPi, band_, settings);
  }

  MappedFile kernel_;
  MappedFile stars_;
  Ephemeris ephemeris_;
  StarCatalogue catalogue_;
  Sky sky_;
  BandPhotometry band_;
  Epoch epoch_ = *Epoch::parse("2028-03-01T12:00:00 TDB");
};

// Every star of the catalogue one by one, without any cone search.
TEST_F(SkyTest, TheConeHoldsExactlyTheStarsWhoseApparentPlacesAreInside) {
  State observer = earth();
  observer.v_m_s *= 20.0;  // 600 km/s: 7 arcmin of aberration, as far as Parker Solar Probe goes three times over
  const SkySettings settings{.max_v_mag = 7.0};
  for (const Vec3& axis : {direction_from_radec(4.66, -0.5), Vec3(0.0, 0.0, 1.0), direction_from_radec(0.0, 0.08)}) {
    for (const double radius : {0.5 * kDegree, 14.0 * kDegree, 100.0 * kDegree}) {
      std::vector<std::int64_t> expected;
      for (std::size_t i = 0; i < catalogue_.size(); ++i) {
        const Star star = catalogue_.star(i);
        if (star.v_mag > 7.0f) continue;
        const Vec3 seen = aberrate(star_direction(star, epoch_, observer.p_m), observer.v_m_s);
        if (angle_between(seen, axis) <= radius) expected.push_back(star.id);
      }
      std::vector<std::int64_t> found;
      const auto sources = *sky_.look(epoch_, observer, axis, radius, band_, settings);
      for (const SkySource& s : sources) {
        if (s.kind == SourceKind::star) found.push_back(s.id);
      }
      std::sort(expected.begin(), expected.end());
      std::sort(found.begin(), found.end());
      EXPECT_EQ(found, expected) << radius;
    }
  }
}

TEST_F(SkyTest, StarsStandWhereMotionParallaxAndAberrationPutThem) {
  const State observer = earth();
  std::size_t stars = 0;
  for (const SkySource& s : all_sky(observer, {.max_v_mag = 6.0})) {
    if (s.kind != SourceKind::star) continue;
    const Star star = catalogue_.star(*catalogue_.find(static_cast<std::uint32_t>(s.id)));
    const Vec3 alone = aberrate(star_direction(star, epoch_, observer.p_m), observer.v_m_s);
    EXPECT_LT(angle_between(s.direction_N, alone), 1e-3 * kMilliarcsecond) << s.id;
    EXPECT_NEAR(s.direction_N.norm(), 1.0, 1e-15);
    if (++stars == 300) break;  // finding a star by its number takes its time
  }
  EXPECT_EQ(stars, 300u);
}

TEST_F(SkyTest, BrightestFirstAndSiriusLeadsTheStars) {
  const auto sources = all_sky(earth(), {.max_v_mag = 4.0});
  EXPECT_TRUE(std::is_sorted(sources.begin(), sources.end(),
                             [](const SkySource& a, const SkySource& b) { return a.v_mag < b.v_mag; }));
  const auto first_star =
      std::find_if(sources.begin(), sources.end(), [](const SkySource& s) { return s.kind == SourceKind::star; });
  ASSERT_NE(first_star, sources.end());
  EXPECT_EQ(first_star->id, 32349);
  EXPECT_NEAR(first_star->v_mag, -1.44, 0.02);
  EXPECT_GT(first_star->flux.electrons_per_s, 1e7);
  EXPECT_GT(first_star->flux.irradiance_w_m2, 0.0);
}

TEST_F(SkyTest, AnObserverOnEarthSeesAllButEarth) {
  const auto sources = all_sky(earth(), {.max_v_mag = 0.0});
  for (const BodyId id :
       {body::mercury, body::venus, body::moon, body::mars, body::jupiter, body::saturn, body::uranus, body::neptune}) {
    EXPECT_NE(find(sources, SourceKind::planet, id.value), nullptr) << id.value;
  }
  EXPECT_EQ(find(sources, SourceKind::planet, body::earth.value), nullptr);
  EXPECT_NE(find(all_sky({}, {.max_v_mag = 0.0}), SourceKind::planet, body::earth.value), nullptr);
}

TEST_F(SkyTest, PlanetsStandWhereLightTimeAndAberrationPutThem) {
  const State observer = earth();
  const auto sources = all_sky(observer, {.max_v_mag = 0.0, .centre_of_light = false});
  const SkySource* jupiter = find(sources, SourceKind::planet, body::jupiter.value);
  ASSERT_NE(jupiter, nullptr);
  const BodyId held = *ephemeris_.resolve(body::jupiter);
  const LightTime seen = *light_time(ephemeris_, held, observer, epoch_);
  EXPECT_LT(angle_between(jupiter->direction_N, aberrate(seen.relative.p_m.normalized(), observer.v_m_s)),
            1e-6 * kArcsecond);
  // Each correction moves it by what it should: up to 20.5 arcsec.
  const SkySettings geometric{.max_v_mag = 0.0, .aberration = false, .light_time = false, .centre_of_light = false};
  const SkySource at_rest = *find(all_sky(observer, geometric), SourceKind::planet, body::jupiter.value);
  const State true_place = *ephemeris_.state(held, body::solar_system_barycenter, epoch_);
  EXPECT_LT(angle_between(at_rest.direction_N, true_place.p_m - observer.p_m), 1e-6 * kArcsecond);
  EXPECT_GT(angle_between(at_rest.direction_N, jupiter->direction_N), 1.0 * kArcsecond);
}

// Photocentre of a Lambert sphere by summing over its surface.
double summed_shift(double phase) {
  double light = 0.0;
  double moment = 0.0;
  const int n = 1500;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const double x = -1.0 + (2.0 * i + 1.0) / n;  // towards the Sun's side
      const double y = -1.0 + (2.0 * j + 1.0) / n;
      if (x * x + y * y >= 1.0) continue;
      const double z = std::sqrt(1.0 - x * x - y * y);  // towards the observer
      const double lit = x * std::sin(phase) + z * std::cos(phase);
      if (lit <= 0.0) continue;
      light += lit;
      moment += lit * x;
    }
  }
  return moment / light;
}

TEST_F(SkyTest, PhotocentreOfALambertSphere) {
  for (const double degrees : {5.0, 40.0, 90.0, 130.0, 160.0}) {
    EXPECT_NEAR(lambert_photocentre_shift(1.0, degrees * kDegree), summed_shift(degrees * kDegree), 1e-3) << degrees;
  }
  EXPECT_EQ(lambert_photocentre_shift(1.0, 0.0), 0.0);
  // A vanishing crescent: its width and its brightness both go with the cosine c along the limb, so <c> = 9 pi / 32.
  EXPECT_NEAR(lambert_photocentre_shift(1.0, 179.8 * kDegree), 9.0 * kPi / 32.0, 1e-4);
  EXPECT_NEAR(lambert_photocentre_shift(1.0, kPi), 9.0 * kPi / 32.0, 1e-12);
}

TEST_F(SkyTest, ThePhotocentreLiesTowardsTheSun) {
  const State observer = earth();
  const SkySettings figure{.max_v_mag = 0.0, .aberration = false, .centre_of_light = false};
  SkySettings light = figure;
  light.centre_of_light = true;
  const SkySource centre = *find(all_sky(observer, figure), SourceKind::planet, body::venus.value);
  const SkySource photo = *find(all_sky(observer, light), SourceKind::planet, body::venus.value);
  light.centre_of_light_scale = 2.0;
  const SkySource twice = *find(all_sky(observer, light), SourceKind::planet, body::venus.value);
  const LightTime seen = *light_time(ephemeris_, *ephemeris_.resolve(body::venus), observer, epoch_);
  const Vec3 sun = ephemeris_.state(body::sun, body::solar_system_barycenter, epoch_)->p_m - observer.p_m;
  const Illumination geometry{seen.relative.p_m - sun, seen.relative.p_m, epoch_};
  const double shift = angle_between(centre.direction_N, photo.direction_N);
  EXPECT_NEAR(shift * seen.relative.p_m.norm(), lambert_photocentre_shift(6051.8e3, phase_angle(geometry)), 2e3);
  EXPECT_NEAR(angle_between(centre.direction_N, twice.direction_N) / shift, 2.0, 1e-6);
  light.own_laws = {{body::mars, 0.0}, {body::venus, 0.5}};
  const SkySource once = *find(all_sky(observer, light), SourceKind::planet, body::venus.value);
  EXPECT_NEAR(angle_between(centre.direction_N, once.direction_N) / shift, 1.0, 1e-6);
  EXPECT_LT(angle_between(photo.direction_N, sun), angle_between(centre.direction_N, sun));
}

// The whole lit disc, seen by an observer in motion: the sub-solar limb is aberrated point by point.
TEST_F(SkyTest, TheDiscIsThatOfTheBodySeenByTheMovingObserver) {
  State observer = earth();
  observer.v_m_s *= 300.0;  // 9000 km/s: 3 % of c, so that aberration turns and stretches the disc visibly
  const SkySource venus = *find(all_sky(observer, {.max_v_mag = 0.0}), SourceKind::planet, body::venus.value);
  const LightTime seen = *light_time(ephemeris_, *ephemeris_.resolve(body::venus), observer, epoch_);
  const Vec3 p = seen.relative.p_m;
  const Vec3 from_sun =
      ephemeris_.state(body::venus_barycenter, body::sun, epoch_ - Duration::seconds(seen.light_time_s))->p_m;
  EXPECT_NEAR(venus.phase_angle_rad, phase_angle({from_sun, p, epoch_}), 1e-12);
  const Vec3 across = (-from_sun - p.normalized() * p.normalized().dot(-from_sun)).normalized();
  const double shift = lambert_photocentre_shift(6051.8e3, venus.phase_angle_rad);
  const Vec3 light = aberrate((p + shift * across).normalized(), observer.v_m_s);
  const Vec3 limb = aberrate((p + (shift + 6051.8e3) * across).normalized(), observer.v_m_s);
  EXPECT_LT(angle_between(venus.direction_N, light), 1e-9 * kArcsecond);
  EXPECT_NEAR(venus.angular_radius_rad / angle_between(light, limb), 1.0, 1e-6);
  EXPECT_LT(angle_between(venus.sunward_N, limb - light), 1e-3);
  EXPECT_NEAR(venus.sunward_N.norm(), 1.0, 1e-14);
  EXPECT_NEAR(venus.sunward_N.dot(venus.direction_N), 0.0, 1e-14);
  // The paper's way: a point.
  const SkySettings paper{.max_v_mag = 0.0, .centre_of_light = false};
  EXPECT_EQ(find(all_sky(observer, paper), SourceKind::planet, body::venus.value)->angular_radius_rad, 0.0);
}

// Cones too small to hold anything but one body: asking in advance whether it may be inside must not lose it.
TEST_F(SkyTest, EveryBodyIsFoundInANarrowConeAroundItself) {
  for (const double faster : {1.0, 1000.0}) {
    State observer = earth();
    observer.v_m_s *= faster;
    const auto sources = all_sky(observer, {.max_v_mag = -5.0});
    EXPECT_EQ(sources.size(), 10u);  // the Sun, eight planets and the Moon, without the Earth, with Pluto
    for (const SkySource& source : sources) {
      const auto narrow =
          *sky_.look(epoch_, observer, source.direction_N, 0.01 * kArcsecond, band_, {.max_v_mag = -5.0});
      EXPECT_NE(find(narrow, source.kind, source.id), nullptr) << source.id;
    }
  }
}

TEST_F(SkyTest, SmallBodiesAreSeenWhereAKernelHoldsThem) {
  const auto ceres = ASTRONAV_SHARED_DATA("ephemeris/2000001.bsp");
  const auto vesta = ASTRONAV_SHARED_DATA("ephemeris/2000004.bsp");
  const MappedFile ceres_file = *MappedFile::open(ceres), vesta_file = *MappedFile::open(vesta);
  const std::vector<std::span<const std::byte>> kernels{kernel_.bytes(), ceres_file.bytes(), vesta_file.bytes()};
  const Ephemeris ephemeris = *Ephemeris::open(kernels);
  const Sky sky(ephemeris, catalogue_);
  const State observer = earth();
  SkySettings settings{.max_v_mag = 2.0};
  const auto look = [&](Epoch epoch) { return *sky.look(epoch, observer, Vec3::UnitX(), kPi, band_, settings); };
  const auto sources = look(epoch_);
  for (const std::int32_t id : {2000001, 2000004}) {
    const SkySource* body = find(sources, SourceKind::small_body, id);
    ASSERT_NE(body, nullptr) << id;
    EXPECT_GT(body->v_mag, 5.0);
    EXPECT_LT(body->v_mag, 9.5);
    EXPECT_GT(body->flux.electrons_per_s, 0.0);
    const LightTime seen = *light_time(ephemeris, BodyId{id}, observer, epoch_);
    EXPECT_LT(angle_between(body->direction_N, aberrate(seen.relative.p_m.normalized(), observer.v_m_s)),
              body->angular_radius_rad);
    EXPECT_NEAR(body->angular_radius_rad * seen.relative.p_m.norm(), known_small_body({id})->mean_radius_m, 100.0);
  }
  // What the caller says counts; by whichever number.
  const double v_mag = find(sources, SourceKind::small_body, 2000001)->v_mag;
  settings.bodies = {{.id = {20000001}, .law = {.h = 0.34, .g1 = 0.12}, .mean_radius_m = 0.0}};
  const auto told = look(epoch_);
  EXPECT_EQ(told.size(), sources.size());
  ASSERT_NE(find(told, SourceKind::small_body, 20000001), nullptr);
  EXPECT_NEAR(find(told, SourceKind::small_body, 20000001)->v_mag, v_mag - 3.0, 1e-9);
  // Beyond its kernel a small body is just not there.
  EXPECT_EQ(find(look(*Epoch::parse("2040-01-01 TDB")), SourceKind::small_body, 2000004), nullptr);
}

TEST_F(SkyTest, TheSunShinesWithItsMagnitudeAndSize) {
  State observer = earth();
  const Vec3 sun = light_time(ephemeris_, body::sun, observer, epoch_)->relative.p_m;
  EXPECT_LT((sky_.sun_N_m(epoch_, observer) - sun).norm(), 1e-3);
  const auto sources = *sky_.look(epoch_, observer, aberrate(sun.normalized(), observer.v_m_s), 0.3 * kDegree, band_,
                                  {.max_v_mag = 0.0});
  const SkySource* seen = find(sources, SourceKind::sun, body::sun.value);
  ASSERT_NE(seen, nullptr);
  EXPECT_NEAR(seen->v_mag, -26.76, 0.04);  // 0.983 to 1.017 au
  EXPECT_NEAR(seen->angular_radius_rad / kArcsecond, 959.6 * kAstronomicalUnit / sun.norm(), 1.0);
  EXPECT_LT(angle_between(seen->direction_N, aberrate(sun.normalized(), observer.v_m_s)), 1e-9);
}

TEST_F(SkyTest, BodiesHideWhatIsBehindThem) {
  // 4000 km from the Moon's centre on the far side of the Earth: half of the sky is behind it but for a ring.
  State observer = earth();
  const Vec3 moon = ephemeris_.state(body::moon, body::earth, epoch_)->p_m;
  observer.p_m += moon * (1.0 + 4000e3 / moon.norm());
  const Vec3 down = -moon.normalized();
  SkySettings geometric{.max_v_mag = 5.0, .aberration = false, .light_time = false};
  const double radius = std::asin(1737.4 / 4000.0);
  const auto sources = all_sky(observer, geometric);
  std::size_t hidden = 0, shown = 0;
  for (const SkySource& s : all_sky(earth(), geometric)) {  // parallax at the Moon is nothing for a star
    if (s.kind != SourceKind::star) continue;
    const bool behind = angle_between(s.direction_N, down) < radius;
    EXPECT_EQ(find(sources, s.kind, s.id) == nullptr, behind) << s.id;
    ++(behind ? hidden : shown);
  }
  EXPECT_GT(hidden, 20u);
  EXPECT_GT(shown, 1000u);
  // The Earth is behind the Moon too; the Moon is drawn although its centre lies far outside of a narrow cone.
  EXPECT_EQ(find(sources, SourceKind::planet, body::earth.value), nullptr);
  const Vec3 limb = std::cos(radius) * down + std::sin(radius) * down.unitOrthogonal();
  EXPECT_NE(
      find(*sky_.look(epoch_, observer, limb, 1.0 * kDegree, band_, geometric), SourceKind::planet, body::moon.value),
      nullptr);
}

TEST_F(SkyTest, AnObserverOnTheGroundSeesHalfTheSky) {
  const GroundSite site{.latitude_rad = 0.9, .longitude_rad = 0.2, .height_m = 100.0};
  State observer = earth();
  const State place = ground_state(site, epoch_);
  observer.p_m += place.p_m;
  observer.v_m_s += place.v_m_s;
  const Vec3 zenith = ground_zenith(site, epoch_);
  for (const SkySource& s : all_sky(observer, {.max_v_mag = 5.0})) {
    EXPECT_LT(angle_between(s.direction_N, zenith), 94.0 * kDegree)
        << s.id;  // the globe's mean radius, its own vertical
  }
  EXPECT_GT(all_sky(earth(), {.max_v_mag = 5.0}).size(), 1.9 * all_sky(observer, {.max_v_mag = 5.0}).size());
}

TEST_F(SkyTest, TheAirLiftsWhatIsSeen) {
  const GroundSite site{.latitude_rad = 0.9, .longitude_rad = 0.2, .height_m = 100.0};
  State observer = earth();
  const State place = ground_state(site, epoch_);
  observer.p_m += place.p_m;
  observer.v_m_s += place.v_m_s;
  const Vec3 zenith = ground_zenith(site, epoch_);
  const Refraction air({}, zenith);
  const auto [east, north] = east_north(zenith);
  const Vec3 low = std::cos(75.0 * kDegree) * zenith + std::sin(75.0 * kDegree) * north;
  SkySettings settings{.max_v_mag = 6.0};
  const auto above = all_sky(observer, settings);
  settings.refraction = air;
  const auto sources = *sky_.look(epoch_, observer, low, 5.0 * kDegree, band_, settings);
  std::size_t expected = 0;
  for (const SkySource& s : above) expected += angle_between(air.refract(s.direction_N), low) <= 5.0 * kDegree;
  EXPECT_EQ(sources.size(), expected);
  ASSERT_GT(sources.size(), 3u);
  for (const SkySource& s : sources) {
    const SkySource& without = *find(above, s.kind, s.id);
    EXPECT_LT(angle_between(s.direction_N, air.refract(without.direction_N)), 1e-6 * kArcsecond);
    EXPECT_GT(angle_between(without.direction_N, zenith) - angle_between(s.direction_N, zenith), 100.0 * kArcsecond);
  }
}

// Lalande 21185 (HIP 54035), a dwarf of B-V 1.50, and Aldebaran, a giant of 1.54.
TEST_F(SkyTest, RedDwarfsAreNotTakenForGiants) {
  const auto sources = all_sky(earth(), {.max_v_mag = 8.0});
  const SkySource* dwarf = find(sources, SourceKind::star, 54035);
  ASSERT_NE(dwarf, nullptr);
  const double excess =
      2.5 * std::log10(dwarf->flux.electrons_per_s / band_.flux(dwarf->v_mag, dwarf->b_v).electrons_per_s);
  EXPECT_GT(excess, 0.3);
  EXPECT_LT(excess, 0.9);
  const SkySource* giant = find(sources, SourceKind::star, 21421);  // Aldebaran
  ASSERT_NE(giant, nullptr);
  EXPECT_EQ(giant->flux.electrons_per_s, band_.flux(giant->v_mag, giant->b_v).electrons_per_s);
}

// 9,000 stars: the share scatters by 0.4 % (1 sigma).
TEST_F(SkyTest, AShareOfTheStarsHasACompanionThatStaysTheSame) {
  const SkySettings alone{.max_v_mag = 6.5}, with{.max_v_mag = 6.5, .companion_share = 0.2, .companion_seed = 7};
  const auto stars = all_sky(earth(), alone), both = all_sky(earth(), with);
  const double companions = static_cast<double>(both.size() - stars.size());
  const auto known =
      std::count_if(stars.begin(), stars.end(), [](const SkySource& s) { return s.kind == SourceKind::star; });
  EXPECT_NEAR(companions / static_cast<double>(known), 0.2, 0.02);
  EXPECT_TRUE(std::is_sorted(both.begin(), both.end(),
                             [](const SkySource& a, const SkySource& b) { return a.v_mag < b.v_mag; }));
  const auto again = all_sky(earth(), with);
  ASSERT_EQ(again.size(), both.size());
  for (std::size_t i = 0; i < both.size(); ++i) ASSERT_EQ(again[i].direction_N, both[i].direction_N);
  SkySettings other = with;
  other.companion_seed = 8;
  EXPECT_NE(all_sky(earth(), other).size(), both.size());
  const SkySource* brightest = find(both, SourceKind::star, 0);
  ASSERT_NE(brightest, nullptr);
  double nearest = kPi;
  for (const SkySource& s : stars) {
    if (s.kind != SourceKind::star || s.v_mag > brightest->v_mag || brightest->v_mag > s.v_mag + 4.0) continue;
    nearest = std::min(nearest, angle_between(s.direction_N, brightest->direction_N));
  }
  EXPECT_GT(nearest, 0.09 * kArcsecond);
  EXPECT_LT(nearest, 10.01 * kArcsecond);
}

TEST_F(SkyTest, BeyondTheEphemerisIsAnError) {
  const auto sources = sky_.look(*Epoch::parse("2100-01-01 TDB"), {}, Vec3::UnitX(), 0.1, band_, SkySettings{});
  ASSERT_FALSE(sources);
  EXPECT_EQ(sources.error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav::sky
