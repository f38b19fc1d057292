// SPDX-License-Identifier: Apache-2.0
// One real file for each SPK type: what its segments promise, and what nature promises of the bodies in them.
#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "models/ephemeris/ephemeris.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

constexpr double kSunGm = 1.3271244004127942e20;  // m3/s2
constexpr double kMarsGm = 4.282837362069909e13;
constexpr double kSaturnGm = 3.793120623436167e16;

struct Kernel {
  MappedFile file;
  Ephemeris ephemeris;

  const Ephemeris::Segment& segment() const { return ephemeris.segments()[0]; }
  State at(double tdb_s, std::size_t index = 0) const {
    const auto& s = ephemeris.segments()[index];
    const auto state = ephemeris.state(s.target, s.center, Epoch::tdb_seconds(tdb_s));
    EXPECT_TRUE(state) << describe(state.error());
    return state.value_or(State{});
  }
  // Word i of the first segment.
  double word(std::size_t i) const {
    std::uint64_t bits;
    std::memcpy(&bits, file.bytes().data() + segment().first_byte + 8 * i, 8);
    return std::bit_cast<double>(segment().swap_bytes ? __builtin_bswap64(bits) : bits);
  }
  std::size_t words() const { return (segment().last_byte + 1 - segment().first_byte) / 8; }
  State stored(std::size_t i) const {
    return {1e3 * Vec3(word(i), word(i + 1), word(i + 2)), 1e3 * Vec3(word(i + 3), word(i + 4), word(i + 5))};
  }
  double begin() const { return segment().begin_tdb_s; }
  double end() const { return segment().end_tdb_s; }
  double span() const { return end() - begin(); }
};

Kernel open(const std::filesystem::path& path, int type) {
  auto file = MappedFile::open(path);
  EXPECT_TRUE(file) << path;
  auto ephemeris = Ephemeris::open(file->bytes());
  EXPECT_TRUE(ephemeris) << path << ": " << describe(ephemeris.error());
  EXPECT_EQ(ephemeris->segments()[0].type, type);
  return {std::move(*file), std::move(*ephemeris)};
}

// Position by the trapezoidal rule with its end correction over small steps: no jump, and the velocity is the rate of
// the position. The limit is in metres for one step.
void expect_velocity_to_carry_position(const Kernel& kernel, double begin, double end, int steps, double limit_m) {
  const double h = (end - begin) / steps;
  State before = kernel.at(begin);
  double worst = 0.0;
  for (int i = 1; i <= steps; ++i) {
    const double t = begin + i * h;
    const State after = kernel.at(t), middle = kernel.at(t - 0.5 * h);
    // Simpson's rule.
    const Vec3 way = h / 6.0 * (before.v_m_s + 4.0 * middle.v_m_s + after.v_m_s);
    worst = std::max(worst, (after.p_m - before.p_m - way).norm());
    before = after;
  }
  EXPECT_LT(worst, limit_m);
}

Vec3 acceleration(const Kernel& kernel, double t, double h) {
  return (8.0 * (kernel.at(t + h).v_m_s - kernel.at(t - h).v_m_s) -
          (kernel.at(t + 2 * h).v_m_s - kernel.at(t - 2 * h).v_m_s)) /
         (12.0 * h);
}

Vec3 gravity(const Vec3& p, double gm) {
  const double r = p.norm();
  return -gm / (r * r * r) * p;
}

// Dawn, big-endian. Thrust ends on 2008-10-31; from 11-01T03 to 11-04T02 it coasts. What is left beside the Sun:
// planets and light pressure, some 1e-7 m/s2 of 5e-3.
TEST(SpkTypes, Type1Dawn) {
  const auto path = ASTRONAV_SHARED_DATA("trajectories/dawn_rec_081022_081109_090218_v1.bsp");
  const Kernel dawn = open(path, 1);
  EXPECT_TRUE(dawn.segment().swap_bytes);
  expect_velocity_to_carry_position(dawn, dawn.begin(), dawn.end(), 5000, 1.0);
  const double begin = Epoch::parse("2008-11-01T04:00:00 TDB")->tdb_seconds();
  const double end = Epoch::parse("2008-11-04T01:00:00 TDB")->tdb_seconds();
  double worst = 0.0;
  for (double t = begin; t < end; t += 3600.0)
    worst = std::max(worst, (acceleration(dawn, t, 300.0) - gravity(dawn.at(t).p_m, kSunGm)).norm());
  EXPECT_LT(worst, 2.5e-7);
  EXPECT_GT(worst, 1e-9);  // light pressure alone is 1e-7
  // While it thrusts, the acceleration is another.
  const double thrust = Epoch::parse("2008-10-28T00:00:00 TDB")->tdb_seconds();
  EXPECT_NEAR((acceleration(dawn, thrust, 300.0) - gravity(dawn.at(thrust).p_m, kSunGm)).norm(), 8e-5, 2e-5);
}

TEST(SpkTypes, Type1Parker) {
  const auto path = ASTRONAV_SHARED_DATA("trajectories/spp_recon_20210226_20210325_v001.bsp");
  const Kernel parker = open(path, 1);
  expect_velocity_to_carry_position(parker, parker.begin(), parker.end(), 5000, 1.0);
  const double begin = Epoch::parse("2021-03-09T00:00:00 TDB")->tdb_seconds();
  const double end = Epoch::parse("2021-03-20T00:00:00 TDB")->tdb_seconds();
  for (double t = begin; t < end; t += 7200.0) {
    const Vec3 p = parker.at(t).p_m;
    const double difference = (acceleration(parker, t, 300.0) - gravity(p, kSunGm)).norm();
    // 0.016 m2/kg of area catch light of 4.56e-6 N/m2 at 1 au; planets another 1e-7.
    EXPECT_LT(difference, 2e-7 + 0.03 * 4.56e-6 * std::pow(kAstronomicalUnit / p.norm(), 2)) << t;
  }
}

TEST(SpkTypes, Type20MercuryIsContinuousAndFallsTowardsTheSun) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw20_ex.bsp");
  const Kernel mercury = open(path, 20);
  ASSERT_EQ(mercury.segment().record_count, 4);
  expect_velocity_to_carry_position(mercury, mercury.begin(), mercury.end(), 4000, 1.0);
  for (int i = 1; i < 4; ++i) {
    const double border = mercury.segment().init_s + i * mercury.segment().interval_s;
    const State before = mercury.at(border - 1e-3), after = mercury.at(border + 1e-3);
    EXPECT_LT((after.p_m - before.p_m - 2e-3 * after.v_m_s).norm(), 1.0);
    EXPECT_LT((after.v_m_s - before.v_m_s).norm(), 1e-2);
  }
  // With respect to the barycentre, from which the Sun is up to 0.01 au away.
  const double t = mercury.begin() + 0.4 * mercury.span();
  const Vec3 expected = gravity(mercury.at(t).p_m, kSunGm);
  EXPECT_LT((acceleration(mercury, t, 1000.0) - expected).norm(), 0.06 * expected.norm());
}

TEST(SpkTypes, Type21VoyagerAtJupiter) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw21_ex.bsp");
  const Kernel voyager = open(path, 21);
  expect_velocity_to_carry_position(voyager, voyager.begin(), voyager.end(), 500, 1e-2);
}

TEST(SpkTypes, Type21CeresAndVesta) {
  for (const char* name : {"ephemeris/2000001.bsp", "ephemeris/2000004.bsp"}) {
    const auto path = ASTRONAV_SHARED_DATA(name);
    const Kernel body = open(path, 21);
    expect_velocity_to_carry_position(body, body.begin(), body.end(), 5000, 300.0);  // steps of 17 hours
    expect_velocity_to_carry_position(body, body.begin(), body.begin() + 86400.0 * 100, 5000, 1e-2);
  }
}

TEST(SpkTypes, Type5HitsItsStatesAndFollowsConics) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw05_ex.bsp");
  const Kernel kernel = open(path, 5);
  const auto n = static_cast<std::size_t>(kernel.segment().record_count);
  ASSERT_EQ(n, 9u);
  const double gm = 1e9 * kernel.word(kernel.words() - 2);
  for (std::size_t i = 0; i < n; ++i) {
    const double t = kernel.word(6 * n + i);
    const State expected = kernel.stored(6 * i), found = kernel.at(t);
    EXPECT_LT((found.p_m - expected.p_m).norm(), 1e-9 * expected.p_m.norm()) << i;
    EXPECT_LT((found.v_m_s - expected.v_m_s).norm(), 1e-9 * expected.v_m_s.norm()) << i;
    // Just after a node its own conic counts, but for the square of the time: gm / r2 is enormous in this file.
    if (i + 1 == n) continue;
    const double r = expected.p_m.norm();
    const double dt = 1e-3 * std::sqrt(r * r * r / gm);
    const State later = kernel.at(t + dt);
    const Vec3 fall = expected.p_m + dt * expected.v_m_s + 0.5 * dt * dt * gravity(expected.p_m, gm);
    EXPECT_LT((later.p_m - fall).norm(), 1e-5 * r) << i;
  }
}

// Made-up states: only the nodes are promised, and by type 12 the slopes.
TEST(SpkTypes, Types8And12HitTheirStates) {
  for (const auto& [name, type] :
       {std::pair{"spk-types/orekit_spkw08_ex.bsp", 8}, {"spk-types/orekit_spkw12_ex.bsp", 12}}) {
    const auto path = ASTRONAV_SHARED_DATA(name);
    const Kernel kernel = open(path, type);
    const auto n = static_cast<std::size_t>(kernel.segment().record_count);
    for (std::size_t i = 0; i < n; ++i) {
      const double t = kernel.segment().init_s + static_cast<double>(i) * kernel.segment().interval_s;
      const State found = kernel.at(t), expected = kernel.stored(6 * i);
      EXPECT_LT((found.p_m - expected.p_m).norm(), 1e-6) << i;
      EXPECT_LT((found.v_m_s - expected.v_m_s).norm(), 1e-6) << i;
    }
    // Continuous across the nodes although the window changes there.
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double t = kernel.segment().init_s + static_cast<double>(i) * kernel.segment().interval_s;
      EXPECT_LT((kernel.at(t + 1e-8).p_m - kernel.at(t - 1e-8).p_m).norm(), 0.1) << i;
    }
    if (type == 12) expect_velocity_to_carry_position(kernel, kernel.begin(), kernel.end(), 8 * 50, 1e-3);
  }
}

// The same states of Phobos' or Deimos' neighbour 403 about Mars, interpolated by Lagrange and by Hermite.
TEST(SpkTypes, Types9And13HitTheirStatesAndAgree) {
  const auto path9 = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw09_ex.bsp");
  const auto path13 = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw13_ex.bsp");
  const Kernel nine = open(path9, 9), thirteen = open(path13, 13);
  const auto n = static_cast<std::size_t>(nine.segment().record_count);
  ASSERT_EQ(n, 800u);
  for (const Kernel* kernel : {&nine, &thirteen}) {
    for (std::size_t i = 0; i < n; ++i) {
      const double t = kernel->word(6 * n + i);
      if (t < kernel->begin() || t > kernel->end()) continue;
      const State found = kernel->at(t), expected = kernel->stored(6 * i);
      // An epoch is whole nanoseconds, and the file's are not.
      EXPECT_LT((found.p_m - expected.p_m).norm(), 1e-3) << i;
      EXPECT_LT((found.v_m_s - expected.v_m_s).norm(), 1e-5) << i;
    }
  }
  expect_velocity_to_carry_position(thirteen, thirteen.begin() + 100.0, thirteen.end() - 100.0, 3000, 1e-2);
  double worst = 0.0;
  for (double t = nine.begin() + 300.0; t < nine.end() - 300.0; t += 17.0)
    worst = std::max(worst, (nine.at(t).p_m - thirteen.at(t).p_m).norm());
  EXPECT_LT(worst, 5.0);
}

// Phobos: the mean rates of the conic leave out short periods, of 1.5 J2 (R/a)^2 = 4e-4 of the acceleration.
TEST(SpkTypes, Type15PhobosFallsTowardsMars) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw15_ex.bsp");
  const Kernel phobos = open(path, 15);
  for (double t = phobos.begin() + 100.0; t < phobos.end(); t += 500.0) {
    const Vec3 p = phobos.at(t).p_m, expected = gravity(p, kMarsGm);
    EXPECT_NEAR(p.norm(), 9378e3, 150e3);
    EXPECT_LT((acceleration(phobos, t, 10.0) - expected).norm(), 2e-3 * expected.norm()) << t;
  }
  // The velocity is that of the unperturbed conic.
  const double t = phobos.begin() + 0.5 * phobos.span();
  const Vec3 slope = (phobos.at(t + 5.0).p_m - phobos.at(t - 5.0).p_m) / 10.0;
  EXPECT_LT((slope - phobos.at(t).v_m_s).norm(), 2e-3 * slope.norm());
}

// Daphnis, in a gap of Saturn's rings: the oblate planet pulls 1.5 J2 (R/a)^2 = 0.5 % more than a sphere.
TEST(SpkTypes, Type17DaphnisFallsTowardsSaturn) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw17_ex.bsp");
  const Kernel moon = open(path, 17);
  for (double t : {moon.begin() + 1000.0, moon.begin() + 3e8, moon.end() - 1000.0}) {
    const Vec3 p = moon.at(t).p_m, expected = gravity(p, kSaturnGm);
    EXPECT_NEAR(p.norm(), 136500e3, 100e3);
    EXPECT_LT((acceleration(moon, t, 30.0) - 1.0049 * expected).norm(), 1e-3 * expected.norm()) << t;
    // In the plane of the rings.
    const Vec3 pole(std::cos(83.54 * kDegree) * std::cos(40.58 * kDegree),
                    std::cos(83.54 * kDegree) * std::sin(40.58 * kDegree), std::sin(83.54 * kDegree));
    EXPECT_LT(std::abs(p.normalized().dot(pole)), 1e-3);
  }
  expect_velocity_to_carry_position(moon, moon.begin(), moon.begin() + 2e5, 3000, 0.1);
}

TEST(SpkTypes, Type19HitsItsPackets) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw19_subtype0_ex.bsp");
  const Kernel kernel = open(path, 19);
  // An epoch is whole nanoseconds, and the velocities are of 36 km/s. From the end: pointers to five pieces; each holds
  // packets of twelve words, their epochs, and three words more.
  const std::size_t pointers = kernel.words() - 2 - 6;
  int hit = 0;
  for (std::size_t piece = 0; piece < 5; ++piece) {
    const auto begin = static_cast<std::size_t>(kernel.word(pointers + piece)) - 1;
    const auto end = static_cast<std::size_t>(kernel.word(pointers + piece + 1)) - 1;
    const auto packets = static_cast<std::size_t>(kernel.word(end - 1));
    const double from = kernel.begin() + 100.0 * static_cast<double>(piece);
    for (std::size_t i = 0; i < packets; ++i) {
      const double t = kernel.word(begin + 12 * packets + i);
      if (t <= from || t >= from + 100.0) continue;  // borders belong to one of two pieces, and padding to none
      const State found = kernel.at(t), packet = kernel.stored(begin + 12 * i);
      const Vec3 velocity =
          1e3 * Vec3(kernel.word(begin + 12 * i + 6), kernel.word(begin + 12 * i + 7), kernel.word(begin + 12 * i + 8));
      EXPECT_LT((found.p_m - packet.p_m).norm(), 1e-4) << piece << " " << i;
      EXPECT_LT((found.v_m_s - velocity).norm(), 1e-4) << piece << " " << i;
      ++hit;
    }
  }
  EXPECT_GT(hit, 5);
}

TEST(SpkTypes, Type10IsRefusedByName) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw10_ex.bsp");
  const auto file = MappedFile::open(path);
  const auto ephemeris = Ephemeris::open(file->bytes());
  ASSERT_TRUE(ephemeris) << describe(ephemeris.error());
  const auto& segment = ephemeris->segments()[0];
  const auto state = ephemeris->state(segment.target, segment.center, Epoch::tdb_seconds(segment.begin_tdb_s + 1.0));
  ASSERT_FALSE(state);
  EXPECT_EQ(state.error().code, ErrorCode::unsupported);
  EXPECT_TRUE(describe(state.error()).starts_with("SPK type 10 ")) << describe(state.error());
}

// Damaged files of every type: no crash and, under the sanitizer, no byte read outside of them.
TEST(SpkTypes, DamageIsRefusedOrHarmless) {
  int answered = 0, refused = 0;
  for (const char* name :
       {"spk-types/orekit_spkw02_ex.bsp", "spk-types/orekit_spkw03_ex.bsp", "spk-types/orekit_spkw05_ex.bsp",
        "spk-types/orekit_spkw08_ex.bsp", "spk-types/orekit_spkw09_ex.bsp", "spk-types/orekit_spkw12_ex.bsp",
        "spk-types/orekit_spkw13_ex.bsp", "spk-types/orekit_spkw15_ex.bsp", "spk-types/orekit_spkw17_ex.bsp",
        "spk-types/orekit_spkw19_subtype0_ex.bsp", "spk-types/orekit_spkw20_ex.bsp",
        "spk-types/orekit_spkw21_ex.bsp"}) {
    const auto path = ASTRONAV_SHARED_DATA(name);
    const auto file = MappedFile::open(path);
    ASSERT_TRUE(file);
    const auto whole = Ephemeris::open(file->bytes());
    ASSERT_TRUE(whole);
    const auto segment = whole->segments()[0];
    // A copy that ends where the segment does, so that the sanitizer guards its end.
    const auto used = file->bytes().first(std::max<std::size_t>(segment.last_byte + 1, 1024));
    const std::vector<std::byte> original(used.begin(), used.end());
    RandomStream random(StreamId{.seed = 5, .purpose = "spk types mutation"});
    const auto below = [&](std::size_t n) {
      return static_cast<std::size_t>(random.uniform() * static_cast<double>(n));
    };
    for (int i = 0; i < 1500; ++i) {
      std::vector<std::byte> bytes = original;
      for (std::size_t k = 0; k < 1 + below(3); ++k) {
        // The tables hurt most: summary, and the words at the end of the segment.
        std::size_t where = below(bytes.size());
        if (random.uniform() < 0.6) where = segment.last_byte - below(std::min<std::size_t>(80, bytes.size()));
        bytes[where] ^= static_cast<std::byte>(1U << below(8));
      }
      const auto ephemeris = Ephemeris::open(bytes);
      if (!ephemeris) {
        ++refused;
        continue;
      }
      for (const auto& s : ephemeris->segments()) {
        for (const double share : {0.0, 0.3, 0.77, 1.0}) {
          const double t = s.begin_tdb_s + share * (s.end_tdb_s - s.begin_tdb_s);
          if (!(std::abs(t) < 9e9)) continue;
          const auto state = ephemeris->state(s.target, s.center, Epoch::tdb_seconds(t));
          (state ? answered : refused) += 1;
        }
      }
    }
  }
  EXPECT_GT(answered, 1000);
  EXPECT_GT(refused, 1000);
}

}  // namespace
}  // namespace astronav
