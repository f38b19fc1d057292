// SPDX-License-Identifier: Apache-2.0
#include "models/oem/oem.h"

#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav {
namespace {

// After the example of CCSDS 502.0-B-3, figure G-3, with its values; one object about Mars, two segments with a
// covariance after the second.
constexpr const char* kHeader =
    "CCSDS_OEM_VERS = 2.0\n"
    "COMMENT a header comment\n"
    "CREATION_DATE = 1996-11-04T17:22:31\n"
    "ORIGINATOR = NASA/JPL\n"
    "\n";
std::string metadata(const std::string& start, const std::string& stop) {
  return "META_START\nOBJECT_NAME = MARS GLOBAL SURVEYOR\nOBJECT_ID = 1996-062A\nCENTER_NAME = MARS BARYCENTER\n"
         "REF_FRAME = EME2000\nTIME_SYSTEM = UTC\nSTART_TIME = " +
         start + "\nSTOP_TIME = " + stop + "\nINTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7\nMETA_STOP\n";
}
const std::string kFirst = metadata("1996-12-18T12:00:00.331", "1996-12-18T12:02:00.331") +
                           "COMMENT the states\n"
                           "1996-12-18T12:00:00.331 2789.619 -280.045 -1746.755 4.73372 -2.49586 -1.04195\n"
                           "1996-12-18T12:01:00.331 2783.419 -308.143 -1877.071 5.18604 -2.42124 -1.99608\n"
                           "1996-12-18T12:02:00.331 +2776.033 -336.859 -2008.682 5.63678 -2.33951 -1.94687\n";
const std::string kSecond = metadata("1996-12-18T12:02:00.331", "1996-12-18T12:03:00.331") +
                            "1996-12-18T12:02:00.331 2776.033 -336.859 -2008.682 5.63678 -2.33951 -1.94687\r\n"
                            "1996-353T12:03:00.331Z 2.7686E3 -366.0 -2140.0 6.1 -2.25 -1.9 1e-3 2e-3 3e-3\n"
                            "COVARIANCE_START\n"
                            "EPOCH = 1996-12-18T12:02:00.331\n"
                            "COV_REF_FRAME = ICRF\n"
                            "1.0\n0.1 2.0\n0.2 0.3 3.0\n1e-4 2e-4 3e-4 4e-6\n5e-5 6e-5 7e-5 1e-7 5e-6\n"
                            "8e-5 9e-5 1e-4 2e-7 3e-7 6e-6\n"
                            "COVARIANCE_STOP\n";

// The error that a text gives, as a sentence; empty if it is read.
std::string refusal(const std::string& text) {
  const auto oem = parse_oem(text, "x.oem");
  return oem ? "" : describe(oem.error());
}
std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  if (at != std::string::npos) text.replace(at, from.size(), to);
  return text;
}

TEST(Oem, ReadsTwoSegmentsAndCovariance) {
  const auto oem = parse_oem(kHeader + kFirst + kSecond, "x.oem");
  ASSERT_TRUE(oem) << describe(oem.error());
  EXPECT_EQ(oem->object_name, "MARS GLOBAL SURVEYOR");
  EXPECT_EQ(oem->object_id, "1996-062A");
  EXPECT_EQ(oem->originator, "NASA/JPL");
  EXPECT_EQ(oem->creation_date, "1996-11-04T17:22:31");
  ASSERT_EQ(oem->comments.size(), 1u);
  EXPECT_EQ(oem->comments[0], "a header comment");
  EXPECT_EQ(oem->center, body::mars_barycenter);
  EXPECT_EQ(oem->scale, TimeScale::utc);
  ASSERT_EQ(oem->states.size(), 4u) << "the state at the joint counts once";
  EXPECT_DOUBLE_EQ(oem->states[0].p_m.x(), 2789619.0);
  EXPECT_DOUBLE_EQ(oem->states[2].v_m_s.y(), -2339.51);
  EXPECT_DOUBLE_EQ(oem->states[3].p_m.x(), 2768600.0);
  EXPECT_EQ(oem->epochs[0], *Epoch::parse("1996-12-18T12:00:00.331", TimeScale::utc));
  // Day 353 of 1996 is 18 December; a minute of UTC is a minute of TDB within 0.1 us.
  EXPECT_NEAR((oem->epochs[3] - oem->epochs[2]).seconds(), 60.0, 1e-7);
  ASSERT_EQ(oem->covariances.size(), 1u);
  const auto& c = oem->covariances[0];
  EXPECT_EQ(c.epoch, oem->epochs[2]);
  EXPECT_DOUBLE_EQ(c.covariance(2, 2), 3.0e6);
  EXPECT_DOUBLE_EQ(c.covariance(5, 0), 80.0);
  EXPECT_DOUBLE_EQ(c.covariance(0, 5), 80.0);
  EXPECT_DOUBLE_EQ(c.covariance(5, 5), 6.0);
}

// The covariances of CCSDS 502.0-B-3, figure G-13, as printed there, after the states that are printed there.
TEST(Oem, ReadsThePublishedCovariances) {
  const char* text =
      "CCSDS_OEM_VERS = 3.0\nCREATION_DATE = 2019-11-04T17:22:31\nORIGINATOR = NASA/JPL\n"
      "MESSAGE_ID = OEM 201113719185\n"
      "META_START\nOBJECT_NAME = MARS GLOBAL SURVEYOR\nOBJECT_ID = 1996-062A\nCENTER_NAME = MARS BARYCENTER\n"
      "REF_FRAME = EME2000\nTIME_SYSTEM = UTC\nSTART_TIME = 2019-12-28T21:29:07.267\n"
      "USEABLE_START_TIME = 2019-12-28T22:08:02.5\nUSEABLE_STOP_TIME = 2019-12-30T01:18:02.5\n"
      "STOP_TIME = 2019-12-30T01:28:02.267\nINTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7\nMETA_STOP\n\n"
      "COMMENT This block begins after trajectory correction maneuver TCM-3.\n\n"
      "2019-12-28T21:29:07.267 -2432.166 -063.042 1742.754     7.33702 -3.495867 -1.041945\n"
      "2019-12-28T21:59:02.267 -2445.234 -878.141 1873.073     1.86043 -3.421256 -0.996366\n"
      "2019-12-28T22:00:02.267 -2458.079 -683.858 2007.684     6.36786 -3.339563 -0.946654\n"
      "2019-12-30T01:28:02.267 2164.375 1115.811 -688.131     -3.53328 -2.88452 0.88535\n\n"
      "COVARIANCE_START\nEPOCH = 2019-12-28T21:29:07.267\nCOV_REF_FRAME = EME2000\n"
      " 3.3313494e-04\n 4.6189273e-04 6.7824216e-04\n-3.0700078e-04 -4.2212341e-04 3.2319319e-04\n"
      "-3.3493650e-07 -4.6860842e-07 2.4849495e-07       4.2960228e-10\n"
      "-2.2118325e-07 -2.8641868e-07 1.7980986e-07       2.6088992e-10   1.7675147e-10\n"
      "-3.0413460e-07 -4.9894969e-07 3.5403109e-07       1.8692631e-10   1.0088625e-10   6.2244443e-10\n\n"
      "EPOCH = 2019-12-29T21:00:00\nCOV_REF_FRAME = EME2000\n"
      " 3.4424505e-04\n 4.5078162e-04 6.8935327e-04\n-3.0600067e-04 -4.1101230e-04   3.3420420e-04\n"
      "-3.2382549e-07 -4.5750731e-07   2.3738384e-07     4.3071339e-10\n"
      "-2.1007214e-07 -2.7530757e-07   1.6870875e-07     2.5077881e-10   1.8786258e-10\n"
      "-3.0302350e-07 -4.8783858e-07   3.4302008e-07     1.7581520e-10   1.0077514e-10   6.2244443e-10\n"
      "COVARIANCE_STOP\n";
  const auto oem = parse_oem(text, "figure G-13");
  ASSERT_TRUE(oem) << describe(oem.error());
  ASSERT_EQ(oem->covariances.size(), 2u);
  const auto& a = oem->covariances[0].covariance;
  // km2, km2/s and km2/s2 there, m2, m2/s and m2/s2 here.
  EXPECT_DOUBLE_EQ(a(0, 0), 333.13494);
  EXPECT_DOUBLE_EQ(a(2, 1), -422.12341);
  EXPECT_DOUBLE_EQ(a(1, 2), -422.12341);
  EXPECT_DOUBLE_EQ(a(3, 0), -0.33493650);
  EXPECT_DOUBLE_EQ(a(4, 4), 1.7675147e-4);
  EXPECT_DOUBLE_EQ(a(5, 4), 1.0088625e-4);
  EXPECT_EQ(oem->covariances[1].epoch, *Epoch::parse("2019-12-29T21:00:00 UTC"));
  EXPECT_DOUBLE_EQ(oem->covariances[1].covariance(5, 1), -0.48783858);
  EXPECT_TRUE(a.isApprox(a.transpose(), 0.0));
  // And again after our own writing.
  const auto back = parse_oem(to_text(*oem), "memory");
  ASSERT_TRUE(back) << describe(back.error());
  EXPECT_TRUE(back->covariances[0].covariance.isApprox(a, 1e-15));
  EXPECT_TRUE(back->covariances[1].covariance.isApprox(oem->covariances[1].covariance, 1e-15));
}

// On the orbit's own axes: where the spacecraft stands on y and flies along -x + y, the radial sigma is that of y, and
// so on. The covariance stands between two states of a straight flight.
TEST(Oem, TurnsOrbitalCovariances) {
  const auto with = [](const char* frame) {
    const std::string text = kHeader + metadata("2000-01-01T12:00:00", "2000-01-01T12:00:20") +
                             "2000-01-01T12:00:00 10 0 0 -1 1 0\n2000-01-01T12:00:20 -10 20 0 -1 1 0\n"
                             "COVARIANCE_START\nEPOCH = 2000-01-01T12:00:10\nCOV_REF_FRAME = " +
                             frame + "\n1\n0.5 4\n0 0 9\n0 0 0 1e-6\n0 0 0 0 4e-6\n0 0 0 0 0 9e-6\nCOVARIANCE_STOP\n";
    return parse_oem(text, frame);
  };
  for (const char* frame : {"RTN", "RSW"}) {
    const auto oem = with(frame);
    ASSERT_TRUE(oem) << describe(oem.error());
    const auto& c = oem->covariances.at(0).covariance;
    // Radius +y, across it -x, momentum +z.
    EXPECT_NEAR(c(1, 1), 1e6, 1e-3);
    EXPECT_NEAR(c(0, 0), 4e6, 1e-3);
    EXPECT_NEAR(c(0, 1), -0.5e6, 1e-3);
    EXPECT_NEAR(c(2, 2), 9e6, 1e-3);
    EXPECT_NEAR(c(4, 4), 1.0, 1e-9);
    EXPECT_NEAR(c(3, 3), 4.0, 1e-9);
  }
  const auto tnw = with("TNW");
  ASSERT_TRUE(tnw) << describe(tnw.error());
  // Velocity along (-1, 1, 0)/sqrt 2: that direction has the variance of T, the one across it that of N.
  const Vec3 t = Vec3(-1.0, 1.0, 0.0).normalized(), n = Vec3(-1.0, -1.0, 0.0).normalized();
  const Eigen::Matrix3d p = tnw->covariances.at(0).covariance.topLeftCorner<3, 3>();
  EXPECT_NEAR(t.dot(p * t), 1e6, 1e-3);
  EXPECT_NEAR(n.dot(p * n), 4e6, 1e-3);
  EXPECT_NEAR(t.dot(p * n), 0.5e6, 1e-3);
  EXPECT_NE(refusal(kHeader + metadata("2000-01-01T12:00:00", "2000-01-01T12:00:20") +
                    "2000-01-01T12:00:00 10 0 0 -1 1 0\n2000-01-01T12:00:20 -10 20 0 -1 1 0\nCOVARIANCE_START\n"
                    "EPOCH = 2000-01-01T12:00:30\nCOV_REF_FRAME = RTN\n")
                .find("outside the states"),
            std::string::npos);
}

TEST(Oem, RoundTrip) {
  RandomStream random(StreamId{.seed = 5, .purpose = "oem round trip"});
  for (const TimeScale scale : {TimeScale::tdb, TimeScale::tt, TimeScale::tai, TimeScale::utc}) {
    Oem oem;
    oem.scale = scale;
    oem.center = body::sun;
    oem.comments = {"first", "second"};
    const Epoch begin = *Epoch::parse("2026-11-09T00:00:00.123456789", scale);
    for (int i = 0; i < 50; ++i) {
      oem.epochs.push_back(begin + Duration::seconds(3600.0 * i + random.uniform(0.0, 1000.0)));
      // From kilometres to the edge of the solar system.
      const double size = std::pow(10.0, random.uniform(3.0, 13.0));
      oem.states.push_back({size * Vec3(random.normal(), random.normal(), random.normal()),
                            std::pow(10.0, random.uniform(-2.0, 5.0)) * Vec3(random.normal(), random.normal(), 1.0)});
    }
    Mat6 root;
    for (int i = 0; i < 36; ++i) root(i / 6, i % 6) = random.normal() * (i < 18 ? 1e6 : 1e-1);
    oem.covariances.push_back({oem.epochs[7], root * root.transpose()});
    oem.covariances.push_back({oem.epochs[9], 2.0 * root * root.transpose()});
    oem.useable_begin = oem.epochs[1];
    oem.useable_end = oem.epochs[48];

    const std::string text = to_text(oem);
    const auto back = parse_oem(text, "memory");
    ASSERT_TRUE(back) << describe(back.error());
    ASSERT_EQ(back->states.size(), oem.states.size());
    EXPECT_EQ(back->center, oem.center);
    EXPECT_EQ(back->scale, scale);
    EXPECT_EQ(back->comments, oem.comments);
    // Half a nanosecond for the digits, and one for the way through a scale.
    const Duration slack = Duration::nanoseconds(scale == TimeScale::tdb ? 0 : 2);
    for (std::size_t i = 0; i < oem.states.size(); ++i) {
      EXPECT_LE(back->epochs[i] - oem.epochs[i], slack);
      EXPECT_GE(back->epochs[i] - oem.epochs[i], -slack);
      EXPECT_LE((back->states[i].p_m - oem.states[i].p_m).norm(), 1e-14 * oem.states[i].p_m.norm() + 1e-6);
      EXPECT_LE((back->states[i].v_m_s - oem.states[i].v_m_s).norm(), 1e-14 * oem.states[i].v_m_s.norm() + 1e-9);
    }
    ASSERT_EQ(back->covariances.size(), 2u);
    for (std::size_t k = 0; k < 2; ++k) {
      EXPECT_TRUE(back->covariances[k].covariance.isApprox(oem.covariances[k].covariance, 1e-15));
    }
    if (scale == TimeScale::tdb) {
      EXPECT_EQ(back->useable_begin, oem.useable_begin);
      EXPECT_EQ(back->useable_end, oem.useable_end);
    }
  }
}

TEST(Oem, ErrorsNameLineAndColumn) {
  const std::string good = kHeader + kFirst;
  EXPECT_EQ(refusal(good), "");
  EXPECT_NE(refusal("").find("x.oem:1:1: the file is empty"), std::string::npos) << refusal("");
  EXPECT_NE(refusal("hello\n").find("x.oem:1:1: not an Orbit Ephemeris Message"), std::string::npos);
  EXPECT_NE(refusal("<?xml version=\"1.0\"?>").find("XML"), std::string::npos);
  // The broken number stands in line 19 at column 25.
  const std::string number = refusal(replaced(good, "2783.419", "2783,419"));
  EXPECT_NE(number.find("x.oem:19:25: '2783,419' is not a number"), std::string::npos) << number;
  const std::string fields = refusal(replaced(good, " -1.99608", ""));
  EXPECT_NE(fields.find("x.oem:19:1: expected an epoch and 6 numbers"), std::string::npos) << fields;
  const std::string order = refusal(replaced(good, "12:01:00.331", "12:00:00.330"));
  EXPECT_NE(order.find("x.oem:19:1: epoch 1996-12-18T12:00:00.330 is not later"), std::string::npos) << order;
  const std::string outside = refusal(replaced(good, "1996-12-18T12:02:00.331 +", "1996-12-18T12:05:00.331 +"));
  EXPECT_NE(outside.find("x.oem:20:1:"), std::string::npos) << outside;
  const std::string month = refusal(replaced(good, "1996-12-18T12:01", "1996-13-18T12:01"));
  EXPECT_NE(month.find("x.oem:19:1:"), std::string::npos) << month;
  const std::string key = refusal(replaced(good, "OBJECT_ID", "OBJEKT_ID"));
  EXPECT_NE(key.find("x.oem:8:1: unknown keyword 'OBJEKT_ID'"), std::string::npos) << key;
  const std::string twice = refusal(replaced(good, "OBJECT_ID", "OBJECT_NAME"));
  EXPECT_NE(twice.find("x.oem:8:1: OBJECT_NAME is given twice"), std::string::npos) << twice;
  const std::string lacking = refusal(replaced(good, "CENTER_NAME = MARS BARYCENTER\n", ""));
  EXPECT_NE(lacking.find("lack CENTER_NAME"), std::string::npos) << lacking;
  const std::string frame = refusal(replaced(good, "EME2000", "TOD"));
  EXPECT_NE(frame.find("x.oem:10:13: frame 'TOD' is not handled"), std::string::npos) << frame;
  const std::string scale = refusal(replaced(good, "= UTC", "= GPS"));
  EXPECT_NE(scale.find("x.oem:11:15: time system 'GPS' is not handled"), std::string::npos) << scale;
  const std::string infinite = refusal(replaced(good, "2783.419", "inf"));
  EXPECT_NE(infinite.find("not a number"), std::string::npos) << infinite;
  const std::string byte = refusal(replaced(good, "2783.419",
                                            "2783\x01"
                                            "419"));
  EXPECT_NE(byte.find("x.oem:19:29: byte 1 is not printable"), std::string::npos) << byte;
  const std::string zulu =
      refusal(replaced(replaced(good, "= UTC", "= TDB"), "1996-12-18T12:01:00.331", "1996-12-18T12:01:00.331Z"));
  EXPECT_NE(zulu.find("ends in Z"), std::string::npos) << zulu;
  const std::string cut = refusal(good.substr(0, good.find("1996-12-18T12:02:00.331 +")));
  EXPECT_NE(cut.find("x.oem:20:1: the states end before STOP_TIME: is the file cut off?"), std::string::npos) << cut;
}

TEST(Oem, JoinsOnlyWhatIsContiguous) {
  const std::string gap = replaced(kSecond, "1996-12-18T12:02:00.331 2776.033", "1996-12-18T12:02:00.332 2776.033");
  EXPECT_NE(refusal(kHeader + kFirst + gap).find("gap"), std::string::npos);
  const std::string overlap = replaced(kSecond, "1996-12-18T12:02:00.331 2776.033", "1996-12-18T12:02:00.330 2776.033");
  EXPECT_NE(refusal(kHeader + kFirst + overlap).find("overlaps"), std::string::npos);
  const std::string kick = replaced(kSecond, "5.63678", "5.63778");
  EXPECT_NE(refusal(kHeader + kFirst + kick).find("jumps"), std::string::npos);
  const std::string other = replaced(kSecond, "1996-062A", "1996-062B");
  EXPECT_NE(refusal(kHeader + kFirst + other).find("another object"), std::string::npos);
  const std::string center = replaced(kSecond, "MARS BARYCENTER", "SUN");
  EXPECT_NE(refusal(kHeader + kFirst + center).find("another centre"), std::string::npos);
}

TEST(Oem, RefusesBrokenCovariance) {
  const std::string good = kHeader + kFirst + kSecond;
  EXPECT_NE(refusal(replaced(good, "0.1 2.0\n", "0.1 2.0 3.0\n")).find("row 2 of a covariance has 2 numbers"),
            std::string::npos);
  EXPECT_NE(refusal(replaced(good, "0.1 2.0\n", "0.1 -2.0\n")).find("negative"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "COV_REF_FRAME = ICRF", "COV_REF_FRAME = ITRF-97")).find("'ITRF-97' is not handled"),
            std::string::npos);
  EXPECT_NE(refusal(replaced(good, "COVARIANCE_STOP\n", "")).find("without COVARIANCE_STOP"), std::string::npos);
}

// Whatever bytes come: an error with a place, or a message that keeps its promises.
TEST(Oem, SurvivesMutation) {
  const std::string good = kHeader + kFirst + kSecond;
  RandomStream random(StreamId{.seed = 11, .purpose = "oem mutation"});
  int refused = 0, accepted = 0;
  const auto judge = [&](const std::string& text) {
    const auto oem = parse_oem(text, "x.oem");
    if (!oem) {
      ++refused;
      EXPECT_EQ(oem.error().where.view().substr(0, 6), "x.oem:") << describe(oem.error());
      EXPECT_NE(oem.error().code, ErrorCode::internal);
      return;
    }
    ++accepted;
    ASSERT_FALSE(oem->states.empty());
    ASSERT_EQ(oem->states.size(), oem->epochs.size());
    for (std::size_t i = 0; i < oem->states.size(); ++i) {
      ASSERT_TRUE(oem->states[i].p_m.allFinite() && oem->states[i].v_m_s.allFinite());
      if (i > 0) {
        ASSERT_LT(oem->epochs[i - 1], oem->epochs[i]);
      }
    }
    for (const auto& c : oem->covariances) ASSERT_TRUE(c.covariance.allFinite());
  };
  for (std::size_t length = 0; length < good.size(); ++length) judge(good.substr(0, length));
  for (int i = 0; i < 4000; ++i) {
    std::string text = good;
    const int changes = 1 + static_cast<int>(random.uniform() * 3.0);
    for (int k = 0; k < changes; ++k) {
      const auto at = static_cast<std::size_t>(random.uniform() * static_cast<double>(text.size()));
      const auto other = static_cast<std::size_t>(random.uniform() * static_cast<double>(text.size()));
      switch (random.next() % 5) {
        case 0:
          text[at] = static_cast<char>(random.next());
          break;
        case 1:
          text.erase(at, 1 + random.next() % 40);
          break;
        case 2:
          text.insert(at, text.substr(other, random.next() % 60));
          break;
        case 3:
          text[at] = text[other];
          break;
        default:
          text[at] = "0123456789.-+eETZ =\n"[random.next() % 20];
          break;
      }
    }
    judge(text);
  }
  EXPECT_GT(refused, 2000);
  EXPECT_GT(accepted, 100) << "a mutation of a comment or digit leaves a good message";
}

}  // namespace
}  // namespace astronav
