// SPDX-License-Identifier: Apache-2.0
// The force model against two spacecraft that flew, as their navigation teams reconstructed them: Dawn on its way to
// Mars, in the one stretch without thrust and kicks, and Parker Solar Probe between Venus and perihelion.
//
// Two fits by least squares to the kernel's positions (one an hour). One number: CR A/m, the area over mass of a
// sphere; the state at the beginning is the kernel's. Seven: that state as well. Nothing else is fitted; what is left
// is what the force model misses.
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <vector>

#include <Eigen/Dense>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "simulator/dynamics/propagation.h"
#include "support/shared_data.h"

namespace astronav::dynamics {
namespace {

struct Fit {
  double cr_area_over_mass = 0.0;  // m^2/kg
  double worst_km = 0.0;           // of the positions, over the arc
};

class FlownArc : public ::testing::Test {
 protected:
  // The flown spacecraft with the planets of DE405.
  void open(const std::filesystem::path& kernel) {
    planets_ = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value();
    flown_ = MappedFile::open(kernel).value();
    const std::array<std::span<const std::byte>, 2> both{planets_.bytes(), flown_.bytes()};
    ephemeris_ = Ephemeris::open(both).value();
  }
  State flown(BodyId craft, Epoch e) const { return ephemeris_.state(craft, body::solar_system_barycenter, e).value(); }
  Arc fly(const State& start, double cr_area_over_mass, Epoch from, Epoch to) const {
    ForceSettings settings;
    settings.srp_cr_area_over_mass_m2_kg = cr_area_over_mass;
    return propagate(ForceModel::create(ephemeris_, settings).value(), start, from, to).value();
  }
  // Positions flown less positions computed, m; one an hour, both ends included.
  Eigen::VectorXd misses(BodyId craft, const Arc& arc, Epoch from, Epoch to) const {
    const auto hours = static_cast<Eigen::Index>(std::lround((to - from).days() * 24.0));
    Eigen::VectorXd out(3 * (hours + 1));
    for (Eigen::Index i = 0; i <= hours; ++i) {
      const Epoch e = from + Duration::seconds(3600.0 * static_cast<double>(i));
      out.segment<3>(3 * i) = flown(craft, e).p_m - arc.at(e).value().p_m;
    }
    return out;
  }
  static double worst_km(const Eigen::VectorXd& m) {
    double worst = 0.0;
    for (Eigen::Index i = 0; i < m.size(); i += 3) worst = std::max(worst, m.segment<3>(i).norm() * 1e-3);
    return worst;
  }
  // Gauss and Newton, with derivatives by differences. Unknowns: 0, 1 (CR A/m) or 7 (and the state).
  Fit fit(BodyId craft, Epoch from, Epoch to, double cr_area_over_mass, int unknowns) const {
    using Unknowns = Eigen::Matrix<double, 7, 1>;
    const State first = flown(craft, from);
    Unknowns scale;  // of the differences too
    scale << 1e-2, Vec3::Constant(1e3), Vec3::Constant(1e-2);
    const auto area = [&](const Unknowns& x) { return cr_area_over_mass + x[0] * scale[0]; };
    const auto left = [&](const Unknowns& x) {
      const Unknowns d = x.cwiseProduct(scale);
      const State start{first.p_m + d.segment<3>(1), first.v_m_s + d.tail<3>()};
      return misses(craft, fly(start, area(x), from, to), from, to);
    };
    Unknowns x = Unknowns::Zero();
    Eigen::VectorXd m = left(x);
    for (int iteration = 0; unknowns > 0 && iteration < 3; ++iteration) {
      Eigen::MatrixXd slopes(m.size(), unknowns);
      for (int k = 0; k < unknowns; ++k) slopes.col(k) = m - left(x + Unknowns::Unit(k));
      x.head(unknowns) += slopes.colPivHouseholderQr().solve(m);
      m = left(x);
    }
    return {.cr_area_over_mass = area(x), .worst_km = worst_km(m)};
  }

  MappedFile planets_, flown_;
  Ephemeris ephemeris_;
};

Epoch date(const char* text) {
  return Epoch::parse(text, TimeScale::tdb).value();
}

TEST_F(FlownArc, Dawn) {
  const auto kernel = ASTRONAV_SHARED_DATA("trajectories/dawn_rec_081022_081109_090218_v1.bsp");
  open(kernel);
  const BodyId dawn{-203};
  const Epoch from = date("2008-11-01T03:00:00"), to = date("2008-11-04T02:00:00");
  const Fit area = fit(dawn, from, to, 0.0, 1);
  const Fit all = fit(dawn, from, to, 0.0, 7);
  RecordProperty("area_alone_km", fmt::format("{:.4f}", area.worst_km));
  RecordProperty("state_and_area_km", fmt::format("{:.4f}", all.worst_km));
  RecordProperty("cr_area_over_mass_m2_kg",
                 fmt::format("{:.4f} {:.4f}", area.cr_area_over_mass, all.cr_area_over_mass));
  EXPECT_LT(area.worst_km, 0.1);
  EXPECT_LT(all.worst_km, 0.01);
  EXPECT_NEAR(all.cr_area_over_mass, 0.040, 0.001);
  EXPECT_GT(fit(dawn, from, to, 0.0, 0).worst_km, 1.0) << "without the Sun's light";
}

// Its ion engine, from a plan of two arcs (scenarios/dawn-thrust.csv, made of this kernel): ten days of thrust, in
// which it moves Dawn by 28,600 km. Nothing is fitted here; the plan's forces are constant and right to a thousandth,
// and kicks are not in it. 16 km were measured.
TEST_F(FlownArc, DawnUnderThrust) {
  const auto kernel = ASTRONAV_SHARED_DATA("trajectories/dawn_rec_081022_081109_090218_v1.bsp");
  open(kernel);
  const MappedFile file = MappedFile::open(home_directory() / "scenarios/dawn-thrust.csv").value();
  const auto plan = parse_thrust_plan(file.text(), "dawn-thrust.csv");
  ASSERT_TRUE(plan) << describe(plan.error());
  const BodyId dawn{-203};
  const Epoch from = date("2008-10-22T00:10:00"), to = date("2008-10-31T23:00:00");
  ForceSettings settings;
  settings.srp_cr_area_over_mass_m2_kg = 0.0401;
  const auto miss_km = [&](const ForceModel& forces) {
    const Arc arc = propagate(forces, flown(dawn, from), from, to).value();
    return (arc.at(to).value().p_m - flown(dawn, to).p_m).norm() * 1e-3;
  };
  Events events;
  events.thrust = ThrustHistory::as_planned(*plan).value();
  const double with = miss_km(ForceModel::create(ephemeris_, settings, events).value());
  const double without = miss_km(ForceModel::create(ephemeris_, settings).value());
  RecordProperty("with_km", fmt::format("{:.2f}", with));
  RecordProperty("without_km", fmt::format("{:.0f}", without));
  EXPECT_LT(with, 30.0);
  EXPECT_GT(without, 2e4);
}

TEST_F(FlownArc, Parker) {
  const auto kernel = ASTRONAV_SHARED_DATA("trajectories/spp_recon_20210226_20210325_v001.bsp");
  open(kernel);
  const BodyId parker{-96};
  double worst_area = 0.0, worst_all = 0.0;
  // Five days each, from 2021-03-08T07 on; the last ends at 2021-03-20T24.
  for (double day = 0.0; day <= 7.71; day += 7.708 / 6.0) {
    const Epoch from = date("2021-03-08T07:00:00") + Duration::days(day), to = from + Duration::days(5.0);
    const Fit area = fit(parker, from, to, 0.0, 1);
    const Fit all = fit(parker, from, to, 0.0, 7);
    worst_area = std::max(worst_area, area.worst_km);
    worst_all = std::max(worst_all, all.worst_km);
    EXPECT_NEAR(all.cr_area_over_mass, 0.016, 0.0005) << day;
  }
  RecordProperty("area_alone_km", fmt::format("{:.4f}", worst_area));
  RecordProperty("state_and_area_km", fmt::format("{:.4f}", worst_all));
  EXPECT_LT(worst_area, 1.0);
  EXPECT_LT(worst_all, 0.2);
  const Epoch from = date("2021-03-08T07:00:00");
  EXPECT_GT(fit(parker, from, from + Duration::days(5.0), 0.0, 0).worst_km, 5.0) << "without the Sun's light";
}

}  // namespace
}  // namespace astronav::dynamics
