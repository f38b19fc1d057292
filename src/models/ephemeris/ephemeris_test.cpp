// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/ephemeris.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

using Bytes = std::vector<std::byte>;

// ---- A kernel made by hand, so that every byte is known ----

struct TestSegment {
  int target = 0, center = 0, type = 2, frame = 1;
  double begin = 0.0, end = 0.0;
  std::vector<double> words{};  // records and directory
};

class KernelWriter {
 public:
  explicit KernelWriter(bool little = true) : swap_(little != (std::endian::native == std::endian::little)) {
    bytes_.resize(3 * 1024);
    text(0, "DAF/SPK ");
    put(8, std::int32_t{2});
    put(12, std::int32_t{6});
    put(76, std::int32_t{2});
    put(80, std::int32_t{2});
    text(88, little ? "LTL-IEEE" : "BIG-IEEE");
    text(699, std::string("FTPSTR:\r:\n:\r\n:\r\0:\x81:\x10\xce:ENDFTP", 28));
  }
  KernelWriter& add(const TestSegment& segment) {
    const std::size_t at = 1024 + 24 + 40 * count_++;
    const auto first = static_cast<std::int32_t>(bytes_.size() / 8 + 1);
    put(at, segment.begin);
    put(at + 8, segment.end);
    put(at + 16, std::int32_t{segment.target});
    put(at + 20, std::int32_t{segment.center});
    put(at + 24, std::int32_t{segment.frame});
    put(at + 28, std::int32_t{segment.type});
    put(at + 32, first);
    put(at + 36, static_cast<std::int32_t>(first + static_cast<std::int32_t>(segment.words.size()) - 1));
    for (const double word : segment.words) {
      bytes_.resize(bytes_.size() + 8);
      put(bytes_.size() - 8, word);
    }
    put(1024 + 16, static_cast<double>(count_));
    return *this;
  }
  KernelWriter& put(std::size_t at, double value) { return put_raw(at, value); }
  KernelWriter& put(std::size_t at, std::int32_t value) { return put_raw(at, value); }
  KernelWriter& text(std::size_t at, const std::string& s) {
    std::memcpy(bytes_.data() + at, s.data(), s.size());
    return *this;
  }
  const Bytes& bytes() const { return bytes_; }

 private:
  template <typename T>
  KernelWriter& put_raw(std::size_t at, T value) {
    std::byte raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof value);
    for (std::size_t i = 0; i < sizeof(T); ++i) bytes_.at(at + i) = raw[swap_ ? sizeof(T) - 1 - i : i];
    return *this;
  }

  Bytes bytes_;
  bool swap_;
  std::size_t count_ = 0;
};

// Two records of 100 s from t = 0: x = a + b t, y = t^2, z = c, in km.
TestSegment line(int target, int center, double a, double b, double c) {
  TestSegment out{.target = target, .center = center, .begin = 0.0, .end = 200.0};
  for (const double middle : {50.0, 150.0}) {
    // With s = (t - middle) / 50: t^2 = middle^2 + 100 middle s + 2500 s^2, and s^2 = (T0 + T2) / 2.
    for (const double word :
         {middle, 50.0, a + b * middle, 50.0 * b, 0.0, middle * middle + 1250.0, 100.0 * middle, 1250.0, c, 0.0, 0.0})
      out.words.push_back(word);
  }
  for (const double word : {0.0, 100.0, 11.0, 2.0}) out.words.push_back(word);
  return out;
}

Epoch at(double tdb_s) {
  return Epoch::tdb_seconds(tdb_s);
}

std::string failure(const Bytes& bytes) {
  const auto opened = Ephemeris::open(bytes);
  return opened ? "was opened" : describe(opened.error());
}

TEST(Ephemeris, EvaluatesType2InBothByteOrders) {
  for (const bool little : {true, false}) {
    const auto kernel = KernelWriter(little).add(line(10, 0, 7.0, 2.0, -3.0));
    const auto ephemeris = Ephemeris::open(kernel.bytes());
    ASSERT_TRUE(ephemeris) << describe(ephemeris.error());
    for (const double t : {0.0, 13.25, 99.9, 100.0, 100.1, 200.0}) {
      const auto state = ephemeris->state(body::sun, body::solar_system_barycenter, at(t));
      ASSERT_TRUE(state) << describe(state.error());
      EXPECT_LT((state->p_m - 1e3 * Vec3(7.0 + 2.0 * t, t * t, -3.0)).norm(), 1e-6) << t;
      EXPECT_LT((state->v_m_s - 1e3 * Vec3(2.0, 2.0 * t, 0.0)).norm(), 1e-8) << t;
    }
  }
}

TEST(Ephemeris, EvaluatesType3WithItsOwnVelocity) {
  TestSegment segment{.target = 10, .center = 0, .type = 3, .begin = 0.0, .end = 100.0};
  segment.words = {50.0, 50.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 100.0, 14.0, 1.0};
  const auto kernel = KernelWriter().add(segment);
  const auto ephemeris = Ephemeris::open(kernel.bytes());
  ASSERT_TRUE(ephemeris) << describe(ephemeris.error());
  const auto state = ephemeris->state(body::sun, body::solar_system_barycenter, at(75.0));  // s = 0.5
  ASSERT_TRUE(state);
  EXPECT_LT((state->p_m - 1e3 * Vec3(2.0, 5.0, 8.0)).norm(), 1e-9);
  EXPECT_LT((state->v_m_s - 1e3 * Vec3(0.2, 0.5, 0.8)).norm(), 1e-10);
}

TEST(Ephemeris, ChainsThroughCentres) {
  const auto kernel = KernelWriter()
                          .add(line(3, 0, 1000.0, 0.0, 0.0))
                          .add(line(399, 3, 10.0, 0.0, 0.0))
                          .add(line(301, 3, -20.0, 0.0, 5.0))
                          .add(line(5, 0, 500.0, 0.0, 0.0));
  const auto ephemeris = Ephemeris::open(kernel.bytes());
  ASSERT_TRUE(ephemeris);
  const auto x_km = [&](BodyId target, BodyId center) {
    return ephemeris->state(target, center, at(30.0)).value().p_m.x() / 1e3;
  };
  EXPECT_DOUBLE_EQ(x_km(body::earth, body::solar_system_barycenter), 1010.0);
  EXPECT_DOUBLE_EQ(x_km(body::solar_system_barycenter, body::earth), -1010.0);
  EXPECT_DOUBLE_EQ(x_km(body::moon, body::earth), -30.0);
  EXPECT_DOUBLE_EQ(x_km(body::moon, body::jupiter), 480.0);
  EXPECT_DOUBLE_EQ(x_km(body::jupiter, body::jupiter_barycenter), 0.0);
  EXPECT_EQ(ephemeris->resolve(body::jupiter).value(), body::jupiter_barycenter);
  EXPECT_EQ(ephemeris->resolve(body::earth).value(), body::earth);
  EXPECT_EQ(ephemeris->resolve(body::solar_system_barycenter).value(), body::solar_system_barycenter);
}

// Along and across the orbit, with all that goes round the planet, and at the speed at which the orbit turns.
TEST(Ephemeris, DisplacedPlanetsStandWhereTheyAreSaidTo) {
  const auto file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
  ASSERT_TRUE(file);
  const auto right = Ephemeris::open(file->bytes());
  ASSERT_TRUE(right);
  const Ephemeris moved = right->displaced({{body::mars_barycenter, 3000.0, 0.0},
                                            {body::earth_moon_barycenter, 1.0, 1.0},
                                            {body::earth_moon_barycenter, 700.0, -400.0}});
  const Epoch epoch = *Epoch::parse("2027-05-05T00:00:00 TDB");
  const auto state = [&](const Ephemeris& e, BodyId body, Epoch at) {
    return e.state(body, body::solar_system_barycenter, at).value();
  };
  for (const auto& [body, along, across] : {std::tuple{body::mars, 3000.0, 0.0}, std::tuple{body::earth, 700.0, -400.0},
                                            std::tuple{body::moon, 700.0, -400.0}, std::tuple{body::venus, 0.0, 0.0}}) {
    const State a = state(*right, body, epoch), b = state(moved, body, epoch);
    const auto system = barycenter_of(body).value_or(body::earth_moon_barycenter);
    const State orbit = state(*right, body == body::moon ? body::earth_moon_barycenter : system, epoch);
    const Vec3 pole = orbit.p_m.cross(orbit.v_m_s).normalized();
    const Vec3 off = b.p_m - a.p_m;
    EXPECT_NEAR(off.dot(pole.cross(orbit.p_m).normalized()), along, 0.01);
    EXPECT_NEAR(off.dot(pole), across, 0.01);
    EXPECT_NEAR(off.dot(orbit.p_m.normalized()), 0.0, 0.01);
    // The velocity is that of the moving displacement.
    const Duration h = Duration::days(1.0);
    const Vec3 rate = ((state(moved, body, epoch + h).p_m - state(*right, body, epoch + h).p_m) -
                       (state(moved, body, epoch - h).p_m - state(*right, body, epoch - h).p_m)) /
                      (2.0 * h.seconds());
    EXPECT_LT((b.v_m_s - a.v_m_s - rate).norm(), 0.03 * rate.norm() + 1e-9);
  }
  EXPECT_EQ(state(moved, body::sun, epoch).p_m, state(*right, body::sun, epoch).p_m);
}

TEST(Ephemeris, MissingBodiesAndTimesAreNamed) {
  const auto kernel = KernelWriter().add(line(3, 0, 0, 0, 0)).add(line(399, 3, 0, 0, 0)).add(line(-7, -8, 0, 0, 0));
  const auto ephemeris = Ephemeris::open(kernel.bytes()).value();
  const auto missing = ephemeris.state(body::saturn, body::earth, at(1.0));
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::not_found);
  EXPECT_EQ(describe(missing.error()), "no kernel holds saturn (699)");
  const auto late = ephemeris.state(body::earth, body::solar_system_barycenter, at(86400.0));
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, ErrorCode::out_of_range);
  EXPECT_EQ(
      describe(late.error()),
      "the kernels do not reach: earth (399) is known from 2000-01-01T12:00:00 to 2000-01-01T12:03:20 TDB, not at "
      "2000-01-02T12:00:00");
  const auto apart = ephemeris.state(BodyId{-7}, body::earth, at(1.0));
  ASSERT_FALSE(apart);
  EXPECT_EQ(apart.error().code, ErrorCode::not_found);
  EXPECT_EQ(describe(apart.error()), "no kernel connects body -7 and earth (399)");
  const auto span = ephemeris.span(body::earth);
  ASSERT_TRUE(span);
  EXPECT_EQ(span->begin, at(0.0));
  EXPECT_EQ(span->end, at(200.0));
}

TEST(Ephemeris, WhatLiesBeyondTheAnswerNeedNotBeCovered) {
  auto barycentre = line(3, 0, 0, 0, 0);
  barycentre.begin = 150.0;
  const auto kernel = KernelWriter().add(barycentre).add(line(399, 3, 1.0, 0, 0));
  const auto ephemeris = Ephemeris::open(kernel.bytes()).value();
  EXPECT_TRUE(ephemeris.state(body::earth, body::earth_moon_barycenter, at(50.0)));
  const auto beyond = ephemeris.state(body::earth, body::solar_system_barycenter, at(50.0));
  ASSERT_FALSE(beyond);
  EXPECT_NE(describe(beyond.error()).find("earth-moon barycenter"), std::string::npos);
}

TEST(Ephemeris, LaterSegmentsAndKernelsTakePrecedence) {
  auto second = line(10, 0, 2.0, 0.0, 0.0);
  second.begin = 100.0;
  const auto first = KernelWriter().add(line(10, 0, 1.0, 0.0, 0.0)).add(second);
  auto over = line(10, 0, 3.0, 0.0, 0.0);
  over.begin = 150.0;
  const auto other = KernelWriter(false).add(over);
  const std::vector<std::span<const std::byte>> kernels = {first.bytes(), other.bytes()};
  const auto ephemeris = Ephemeris::open(kernels).value();
  const auto x_km = [&](double t) {
    return ephemeris.state(body::sun, body::solar_system_barycenter, at(t)).value().p_m.x() / 1e3;
  };
  EXPECT_DOUBLE_EQ(x_km(50.0), 1.0);
  EXPECT_DOUBLE_EQ(x_km(120.0), 2.0);
  EXPECT_DOUBLE_EQ(x_km(160.0), 3.0);
}

TEST(Ephemeris, OtherTypesAndFramesFailOnlyWhenAskedFor) {
  auto strange = line(301, 3, 0, 0, 0);
  strange.type = 10;
  auto tilted = line(4, 0, 0, 0, 0);
  tilted.frame = 14;
  const auto kernel = KernelWriter().add(line(3, 0, 1, 0, 0)).add(strange).add(tilted);
  const auto ephemeris = Ephemeris::open(kernel.bytes());
  ASSERT_TRUE(ephemeris);
  EXPECT_TRUE(ephemeris->state(body::earth_moon_barycenter, body::solar_system_barycenter, at(1.0)));
  const auto type = ephemeris->state(body::moon, body::earth_moon_barycenter, at(1.0));
  ASSERT_FALSE(type);
  EXPECT_EQ(type.error().code, ErrorCode::unsupported);
  EXPECT_NE(describe(type.error()).find("SPK type 10 "), std::string::npos);
  const auto frame = ephemeris->state(body::mars, body::earth_moon_barycenter, at(1.0));
  ASSERT_FALSE(frame);
  EXPECT_EQ(frame.error().code, ErrorCode::unsupported);
}

TEST(Ephemeris, TurnsTheEclipticFrame) {
  auto ecliptic = line(10, 0, 0.0, 0.0, 1000.0);  // z = 1000 km: towards the pole of the ecliptic
  ecliptic.frame = 17;
  const auto kernel = KernelWriter().add(ecliptic);
  const auto state =
      Ephemeris::open(kernel.bytes())->state(body::sun, body::solar_system_barycenter, Epoch::tdb_seconds(0.0));
  ASSERT_TRUE(state);
  const double obliquity = 23.4392911 * kDegree;
  EXPECT_LT((state->p_m - 1e6 * Vec3(0.0, -std::sin(obliquity), std::cos(obliquity))).norm(), 1e-2);
}

TEST(Ephemeris, AsteroidsAreFoundUnderEitherNumber) {
  const auto kernel = KernelWriter().add(line(20000004, 0, 5.0, 0.0, 0.0)).add(line(2000001, 0, 6.0, 0.0, 0.0));
  const auto ephemeris = Ephemeris::open(kernel.bytes()).value();
  const auto x_km = [&](std::int32_t id) {
    return ephemeris.state(BodyId{id}, body::solar_system_barycenter, at(30.0)).value().p_m.x() / 1e3;
  };
  EXPECT_EQ(x_km(2000004), 5.0);
  EXPECT_EQ(x_km(20000004), 5.0);
  EXPECT_EQ(x_km(20000001), 6.0);
  EXPECT_FALSE(ephemeris.state(BodyId{2000002}, body::solar_system_barycenter, at(30.0)));
}

// A kernel of moons knows their planet as a centre alone, one of planets the barycentre alone.
TEST(Ephemeris, BarycentresStandInForTheCentresOfMoons) {
  const auto planets = KernelWriter().add(line(4, 0, 700.0, 0.0, 0.0)).add(line(10, 0, 1.0, 0.0, 0.0));
  const auto moons = KernelWriter().add(line(401, 499, 9.0, 0.0, 0.0));
  const std::vector<std::span<const std::byte>> both{planets.bytes(), moons.bytes()};
  const auto ephemeris = Ephemeris::open(both).value();
  const auto x_km = [&](std::int32_t target, std::int32_t center) {
    return ephemeris.state(BodyId{target}, BodyId{center}, at(30.0)).value().p_m.x() / 1e3;
  };
  EXPECT_EQ(x_km(499, 0), 700.0);
  EXPECT_EQ(x_km(401, 499), 9.0);
  EXPECT_EQ(x_km(401, 10), 708.0);
  // The moons' kernel alone still gives what it holds.
  EXPECT_EQ(Ephemeris::open(moons.bytes())->state(BodyId{401}, body::mars, at(30.0)).value().p_m.x(), 9e3);
}

TEST(Ephemeris, CirclesOfCentresAreRefused) {
  const auto kernel = KernelWriter().add(line(1, 2, 1, 0, 0)).add(line(2, 1, 1, 0, 0)).add(line(10, 0, 0, 0, 0));
  const auto ephemeris = Ephemeris::open(kernel.bytes());
  ASSERT_TRUE(ephemeris);
  const auto state = ephemeris->state(body::mercury_barycenter, body::sun, at(1.0));
  ASSERT_FALSE(state);
  EXPECT_EQ(state.error().code, ErrorCode::corrupt_data);
}

TEST(Ephemeris, BrokenFilesAreRefusedWithTheirByte) {
  const KernelWriter good = KernelWriter().add(line(10, 0, 7.0, 2.0, -3.0));
  const auto says = [&](auto change, const char* expected) {
    KernelWriter kernel = good;
    change(kernel);
    const std::string message = failure(kernel.bytes());
    EXPECT_NE(message.find(expected), std::string::npos) << message << " instead of " << expected;
  };
  EXPECT_NE(failure({}).find("it has 0 bytes"), std::string::npos);
  EXPECT_NE(failure(Bytes(1023)).find("it has 1023 bytes"), std::string::npos);
  says([](KernelWriter& k) { k.text(0, "SIMPLE  "); }, "byte 0");
  says([](KernelWriter& k) { k.text(0, "DAF/CK  "); }, "not an SPK kernel");
  says([](KernelWriter& k) { k.text(88, "VAX-GFLT"); }, "byte 88");
  says([](KernelWriter& k) { k.put(8, std::int32_t{3}); }, "byte 8");
  says([](KernelWriter& k) { k.text(699 + 7, "\n"); }, "byte 699");
  says([](KernelWriter& k) { k.put(76, std::int32_t{1}); }, "byte 76");
  says([](KernelWriter& k) { k.put(76, std::int32_t{-2}); }, "byte 76");
  says([](KernelWriter& k) { k.put(76, std::int32_t{99}); }, "byte 76");
  says([](KernelWriter& k) { k.put(1024, 2.0); }, "circle");
  says([](KernelWriter& k) { k.put(1024, 1e300); }, "byte 1024");
  says([](KernelWriter& k) { k.put(1024, static_cast<double>(NAN)); }, "byte 1024");
  says([](KernelWriter& k) { k.put(1024 + 16, 26.0); }, "byte 1040");
  says([](KernelWriter& k) { k.put(1024 + 16, -1.0); }, "byte 1040");
  says([](KernelWriter& k) { k.put(1024 + 24, static_cast<double>(NAN)); }, "byte 1048");
  says([](KernelWriter& k) { k.put(1024 + 24, 300.0); }, "byte 1048");
  says([](KernelWriter& k) { k.put(1024 + 24 + 16, std::int32_t{0}); }, "its own centre");
  says([](KernelWriter& k) { k.put(1024 + 24 + 32, std::int32_t{0}); }, "byte 1080");
  says([](KernelWriter& k) { k.put(1024 + 24 + 36, std::int32_t{0x7fffffff}); }, "byte 1080");
  says([](KernelWriter& k) { k.put(1024 + 24 + 36, std::int32_t{386}); }, "no room for its directory");
  const std::size_t directory = good.bytes().size() - 32;
  const std::string place = "byte " + std::to_string(directory);
  says([&](KernelWriter& k) { k.put(directory, static_cast<double>(NAN)); }, place.c_str());
  says([&](KernelWriter& k) { k.put(directory, 50.0); }, "the time that the segment promises");
  says([&](KernelWriter& k) { k.put(directory + 8, 0.0); }, "interval");
  says([&](KernelWriter& k) { k.put(directory + 16, 12.0); }, "12 words");
  says([&](KernelWriter& k) { k.put(directory + 16, 2.0); }, "2 words");
  says([&](KernelWriter& k) { k.put(directory + 24, 3.0); }, "3 records");
  says([&](KernelWriter& k) { k.put(directory + 24, 1e18); }, "records do not fill");
  const std::vector<std::span<const std::byte>> kernels = {good.bytes(), std::span(good.bytes()).first(1500)};
  const auto second = Ephemeris::open(kernels);
  ASSERT_FALSE(second);
  EXPECT_TRUE(describe(second.error()).starts_with("kernel 1: byte ")) << describe(second.error());
}

TEST(Ephemeris, BrokenRecordsFailWhenReached) {
  const auto broken = [](std::size_t word, double value) {
    KernelWriter kernel = KernelWriter().add(line(10, 0, 7.0, 2.0, -3.0));
    kernel.put(3 * 1024 + 8 * word, value);
    return Ephemeris::open(kernel.bytes())->state(body::sun, body::solar_system_barycenter, at(10.0));
  };
  for (const auto& [word, value] : std::vector<std::pair<std::size_t, double>>{
           {0, 150.0}, {0, NAN}, {1, 0.0}, {1, -50.0}, {1, NAN}, {3, NAN}, {3, INFINITY}, {3, 1e200}}) {
    const auto state = broken(word, value);
    ASSERT_FALSE(state) << word << " " << value;
    EXPECT_EQ(state.error().code, ErrorCode::corrupt_data);
    EXPECT_NE(describe(state.error()).find("byte 3072"), std::string::npos);
  }
}

// Ask everything of a kernel that may be broken: no crash and, under the sanitizer, no byte read outside of it.
int exercise(std::span<const std::byte> bytes) {
  const auto ephemeris = Ephemeris::open(bytes);
  if (!ephemeris) {
    EXPECT_FALSE(describe(ephemeris.error()).empty());
    return 0;
  }
  int answers = 0;
  std::size_t asked = 0;
  for (const auto& segment : ephemeris->segments()) {
    if (++asked > 20) break;
    for (const double t :
         {segment.begin_tdb_s, 0.5 * (segment.begin_tdb_s + segment.end_tdb_s), segment.end_tdb_s, 7.3e8}) {
      if (!(std::abs(t) < 9e9)) continue;
      answers += ephemeris->state(segment.target, body::solar_system_barycenter, at(t)).has_value();
      answers += light_time(*ephemeris, segment.target, State{Vec3(1.5e11, 0, 0), Vec3(0, 3e4, 0)}, at(t)).has_value();
    }
    (void)ephemeris->span(segment.target);
  }
  return answers;
}

void mutate(const std::filesystem::path& path, int flips, int cuts, std::uint64_t seed) {
  const auto file = MappedFile::open(path);
  ASSERT_TRUE(file);
  const Bytes original(file->bytes().begin(), file->bytes().end());
  ASSERT_GT(exercise(original), 0) << path;
  RandomStream random(StreamId{.seed = seed, .purpose = "kernel mutation"});
  const auto below = [&](std::size_t n) { return static_cast<std::size_t>(random.uniform() * static_cast<double>(n)); };
  // The tables at the front, and the directories at the ends of the segments, are where damage hurts.
  const auto opened = Ephemeris::open(original);
  const auto segments = opened->segments();
  int refused = 0;
  Bytes bytes = original;
  for (int i = 0; i < flips; ++i) {
    std::vector<std::size_t> touched;
    for (std::size_t k = 0; k < 1 + below(4); ++k) {
      const auto& segment = segments[below(segments.size())];
      std::size_t where = below(bytes.size());
      if (random.uniform() < 0.4) where = below(std::min(bytes.size(), segments.front().first_byte));
      if (random.uniform() < 0.4) where = segment.last_byte - below(32);
      if (random.uniform() < 0.2) where = segment.first_byte + below(16);
      bytes[where] ^= static_cast<std::byte>(1U << below(8));
      touched.push_back(where);
    }
    refused += exercise(bytes) == 0;
    for (const std::size_t where : touched) bytes[where] = original[where];
  }
  EXPECT_EQ(bytes, original);
  for (int i = 0; i < cuts; ++i) {
    // A copy of just that size, so that the sanitizer guards its end.
    const auto size = static_cast<std::ptrdiff_t>(below(random.uniform() < 0.5 ? original.size() : 70'000));
    const Bytes cut(original.begin(),
                    original.begin() + std::min<std::ptrdiff_t>(size, static_cast<std::ptrdiff_t>(original.size())));
    refused += exercise(cut) == 0;
  }
  EXPECT_GT(refused, 0);
}

TEST(EphemerisMutation, HandMadeKernels) {
  for (const bool little : {true, false}) {
    const KernelWriter kernel =
        KernelWriter(little).add(line(3, 0, 1e6, 0, 0)).add(line(399, 3, 0, 0, 0)).add(line(301, 399, 4e5, 1.0, 0));
    Bytes bytes = kernel.bytes();
    ASSERT_GT(exercise(bytes), 0);
    // Every bit of the tables, one after the other.
    for (std::size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
      const std::size_t byte = bit / 8;
      const bool unused = (byte >= 96 && byte < 1024) || (byte >= 1024 + 24 + 3 * 40 && byte < 3 * 1024);
      if (unused) continue;
      bytes[bit / 8] ^= static_cast<std::byte>(1U << bit % 8);
      exercise(bytes);
      bytes[bit / 8] ^= static_cast<std::byte>(1U << bit % 8);
    }
    for (std::size_t size = 0; size < bytes.size(); size += 40)
      exercise(Bytes(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size)));
  }
}

TEST(EphemerisMutation, De440) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/de440s_excerpt_20221231_20260104.bsp");
  mutate(path, 4000, 200, 1);
}

TEST(EphemerisMutation, Type3) {
  const auto path = ASTRONAV_SHARED_DATA("spk-types/orekit_spkw03_ex.bsp");
  const auto file = MappedFile::open(path);
  ASSERT_TRUE(Ephemeris::open(file->bytes()));
  RandomStream random(StreamId{.seed = 2, .purpose = "type 3 mutation"});
  Bytes bytes(file->bytes().begin(), file->bytes().end());
  for (int i = 0; i < 10000; ++i) {
    const auto bit = static_cast<std::size_t>(random.uniform() * 8.0 * static_cast<double>(bytes.size()));
    bytes[bit / 8] ^= static_cast<std::byte>(1U << bit % 8);
    exercise(bytes);
    if (i % 4 == 3) bytes.assign(file->bytes().begin(), file->bytes().end());
  }
}

// ---- Interpolated states: a polynomial of the degree that a window can hold comes back everywhere ----

// Around the middle of the segment, so that high powers stay small; km and km/s.
Vec3 curve(double t, int degree, int derivative) {
  const double x = (t - 450.0) / 400.0;
  Vec3 out = Vec3::Zero();
  for (int k = 0; k <= degree; ++k) {
    double factor = 1.0;
    for (int d = 0; d < derivative; ++d) factor *= (k - d) / 400.0;
    if (k >= derivative) out += factor * std::pow(x, k - derivative) * Vec3(1.0 + k, 2.0 - 0.3 * k, k % 2 ? -4.0 : 3.0);
  }
  return 1e3 * out;
}

// Ten states of the curve, in the layout of a type.
TestSegment sampled(int type, int subtype, int window, int degree) {
  const bool equal = type == 8 || type == 12;
  const int count = 10;
  TestSegment out{.target = 10, .center = 0, .type = type, .begin = 0.0, .end = 900.0};
  std::vector<double> times;
  for (int i = 0; i < count; ++i)
    times.push_back(equal ? 100.0 * i : 100.0 * i + (i % 9 ? 13.0 * std::sin(7.0 * i) : 0.0));
  const auto append = [&](const Vec3& v) { out.words.insert(out.words.end(), {v.x(), v.y(), v.z()}); };
  for (const double t : times) {
    append(curve(t, degree, 0));
    append(curve(t, degree, 1));
    if (type >= 18 && subtype == 0) {
      append(curve(t, degree, 1));
      append(curve(t, degree, 2));
    }
  }
  if (!equal) out.words.insert(out.words.end(), times.begin(), times.end());
  if (equal) out.words.insert(out.words.end(), {0.0, 100.0});
  if (type >= 18) {
    out.words.insert(out.words.end(), {static_cast<double>(subtype), static_cast<double>(window)});
  } else {
    out.words.push_back(window - 1.0);
  }
  out.words.push_back(count);
  if (type == 19) {  // one piece, its borders, where it begins and ends, whose a border is, how many
    const auto end = static_cast<double>(out.words.size() + 1);
    out.words.insert(out.words.end(), {0.0, 900.0, 1.0, end, 1.0, 1.0});
  }
  return out;
}

TEST(Ephemeris, InterpolatedStatesReproducePolynomials) {
  struct Case {
    int type, subtype, window, degree;
  };
  for (const bool little : {true, false}) {
    for (const Case c : {Case{8, 0, 4, 3}, Case{8, 0, 5, 4}, Case{9, 0, 4, 3}, Case{9, 0, 7, 6}, Case{12, 0, 2, 3},
                         Case{12, 0, 4, 7}, Case{13, 0, 2, 3}, Case{13, 0, 3, 5}, Case{18, 0, 4, 7}, Case{18, 1, 6, 5},
                         Case{18, 2, 4, 7}, Case{19, 0, 4, 7}, Case{19, 1, 6, 5}, Case{19, 2, 4, 7}}) {
      const auto kernel = KernelWriter(little).add(sampled(c.type, c.subtype, c.window, c.degree));
      const auto ephemeris = Ephemeris::open(kernel.bytes());
      ASSERT_TRUE(ephemeris) << c.type << ": " << describe(ephemeris.error());
      // Types 18 and 19 take fewer states near the ends.
      const double margin = c.type >= 18 ? 320.0 : 0.0;
      for (double t = margin; t <= 900.0 - margin; t += 11.0) {
        const auto state = ephemeris->state(body::sun, body::solar_system_barycenter, at(t));
        ASSERT_TRUE(state) << describe(state.error());
        EXPECT_LT((state->p_m - 1e3 * curve(t, c.degree, 0)).norm(), 1e-3) << c.type << "/" << c.subtype << " " << t;
        EXPECT_LT((state->v_m_s - 1e3 * curve(t, c.degree, 1)).norm(), 1e-4) << c.type << "/" << c.subtype << " " << t;
      }
      for (const double t : {0.0, 900.0})
        EXPECT_TRUE(ephemeris->state(body::sun, body::solar_system_barycenter, at(t)));
    }
  }
}

// ---- Real kernels: what a segment promises ----

// The velocity is the derivative of the position (type 2: exactly; type 3 holds its own, so only as good as it is).
TEST(EphemerisSegments, VelocityIsTheDerivativeAndPositionIsContinuous) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/de440s_excerpt_20221231_20260104.bsp");
  const auto file = MappedFile::open(path);
  ASSERT_TRUE(file);
  const auto ephemeris = Ephemeris::open(file->bytes());
  ASSERT_TRUE(ephemeris) << describe(ephemeris.error());
  for (const auto& segment : ephemeris->segments()) {
    if (segment.record_count < 4) continue;
    const auto p = [&](double t) { return ephemeris->state(segment.target, segment.center, at(t)).value(); };
    for (int record = 1; record < std::min(segment.record_count, 40); ++record) {
      const double border = segment.init_s + segment.interval_s * record;
      const State before = p(border - 1e-3), after = p(border + 1e-3);
      EXPECT_LT((after.p_m - before.p_m - 2e-3 * before.v_m_s).norm(), 1.0) << segment.target.value;
      const double t = border + 0.3 * segment.interval_s, h = 500.0;
      const Vec3 slope = (8.0 * (p(t + h).p_m - p(t - h).p_m) - (p(t + 2 * h).p_m - p(t - 2 * h).p_m)) / (12.0 * h);
      EXPECT_LT((slope - p(t).v_m_s).norm(), 2e-5) << segment.target.value;
    }
  }
}

TEST(EphemerisSegments, Types2And3OfOrekit) {
  for (const char* name : {"spk-types/orekit_spkw02_ex.bsp", "spk-types/orekit_spkw03_ex.bsp"}) {
    const auto path = ASTRONAV_SHARED_DATA(name);
    const auto file = MappedFile::open(path);
    ASSERT_TRUE(file);
    const auto ephemeris = Ephemeris::open(file->bytes());
    ASSERT_TRUE(ephemeris) << describe(ephemeris.error());
    ASSERT_EQ(ephemeris->segments().size(), 1U);
    const auto& segment = ephemeris->segments()[0];
    const auto middle =
        ephemeris->state(segment.target, segment.center, at(0.5 * (segment.begin_tdb_s + segment.end_tdb_s)));
    EXPECT_TRUE(middle) << describe(middle.error());
    EXPECT_FALSE(ephemeris->state(segment.target, segment.center, at(segment.end_tdb_s + 1.0)));
  }
}

TEST(LightTime, SolvesItsEquation) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/de440s_excerpt_20221231_20260104.bsp");
  const auto file = MappedFile::open(path);
  ASSERT_TRUE(file);
  const auto ephemeris = Ephemeris::open(file->bytes()).value();
  for (const BodyId target : {body::mercury, body::moon, body::jupiter_barycenter, body::neptune_barycenter}) {
    const Epoch epoch = Epoch::parse("2024-05-06T07:08:09 TDB").value();
    const State observer = ephemeris.state(body::earth, body::solar_system_barycenter, epoch).value();
    const auto seen = light_time(ephemeris, target, observer, epoch);
    ASSERT_TRUE(seen);
    EXPECT_NEAR(seen->relative.p_m.norm(), kSpeedOfLight * seen->light_time_s, 1e-2);
    const State there =
        ephemeris.state(target, body::solar_system_barycenter, epoch - Duration::seconds(seen->light_time_s)).value();
    EXPECT_LT((there.p_m - observer.p_m - seen->relative.p_m).norm(), 1e-2);
    // The velocity is the rate of the apparent place.
    const auto place = [&](double dt) {
      const Epoch t = epoch + Duration::seconds(dt);
      return light_time(ephemeris, target, ephemeris.state(body::earth, body::solar_system_barycenter, t).value(), t)
          ->relative.p_m;
    };
    EXPECT_LT(((place(200.0) - place(-200.0)) / 400.0 - seen->relative.v_m_s).norm(), 2e-3) << target.value;
    // Geometric, and SPICE's single step on the way to convergence.
    const auto none = light_time(ephemeris, target, observer, epoch, 0);
    EXPECT_EQ(none->relative.p_m, ephemeris.state(target, body::solar_system_barycenter, epoch)->p_m - observer.p_m);
    const auto once = light_time(ephemeris, target, observer, epoch, 1);
    const double first = (none->relative.p_m - seen->relative.p_m).norm(),
                 second = (once->relative.p_m - seen->relative.p_m).norm();
    EXPECT_LT(second, 2e-4 * first);
    EXPECT_GT(second, 0.0);
  }
}

TEST(LightTime, HostilePlacesAreRefused) {
  const auto kernel = KernelWriter().add(line(10, 0, 1e30, 0.0, 0.0));
  const auto ephemeris = Ephemeris::open(kernel.bytes()).value();
  const auto seen = light_time(ephemeris, body::sun, State{}, at(10.0));
  ASSERT_FALSE(seen);
  EXPECT_EQ(seen.error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav
