// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/smoother.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "foundation/math/statistics.h"
#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation {
namespace {

using namespace testing;
using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

// Largest eigenvalue of `smoothed` - `filtered` where the latter's variances
// are one.
double largest_growth(const StateMatrix& smoothed, const StateMatrix& filtered) {
  StateVector inverse;
  for (int i = 0; i < kStates; ++i) inverse[i] = filtered(i, i) > 0.0 ? 1.0 / std::sqrt(filtered(i, i)) : 1.0;
  const StateMatrix difference = inverse.asDiagonal() * (smoothed - filtered) * inverse.asDiagonal();
  return Eigen::SelfAdjointEigenSolver<StateMatrix>(difference, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
}

// A linear problem, and its answer by least squares over everything at once:
// unknowns are what drives it, x_0 = m + L z_0 and x_k+1 = Phi_k x_k + N_k
// z_k+1 with z ~ N(0, I). Six states are known exactly and driven by nothing,
// noise is of rank three, and in the middle two states start anew: predicted
// covariances are singular.
TEST(Smoother, IsTheLeastSquaresSolutionOfALinearProblem) {
  constexpr int kKnown = 6, kNoise = 3, kSteps = 12, kRestart = 6;
  RandomStream random({.seed = 11, .sample = 0, .purpose = "smoother"});
  const auto draw = [&random](int rows, int columns) {
    Matrix m(rows, columns);
    for (double& v : m.reshaped()) v = random.normal();
    return m;
  };
  const int unknowns = kStates + kSteps * kStates;

  Matrix root = draw(kStates, kStates) / 5.0;
  root.diagonal().array() += 1.0;
  root.topRows(kKnown).setZero();
  const Vector mean = draw(kStates, 1);
  std::vector<Matrix> by_unknowns{Matrix::Zero(kStates, unknowns)};  // of x_k
  by_unknowns[0].leftCols(kStates) = root;
  std::vector<Vector> constant{mean};
  Matrix information = Matrix::Identity(unknowns, unknowns);
  Vector right = Vector::Zero(unknowns);

  std::vector<FilterRecord> records;
  FilterRecord record;
  record.x = mean;
  record.covariance = root * root.transpose();
  for (int k = 0; k <= kSteps; ++k) {
    const Matrix h = draw(2, kStates);
    const Vector z = draw(2, 1) * 3.0;
    const double r = 0.3;
    const Matrix by_z = h * by_unknowns.back();
    information += by_z.transpose() * by_z / r;
    right += by_z.transpose() * (z - h * constant.back()) / r;

    const Matrix S = h * record.covariance * h.transpose() + r * Matrix::Identity(2, 2);
    const Matrix K = record.covariance * h.transpose() * S.inverse();
    record.x += K * (z - h * record.x);
    record.covariance = (record.covariance - K * S * K.transpose()).eval();
    record.epoch = departure() + Duration::seconds(k);
    if (k == kSteps) break;

    Matrix phi = Matrix::Identity(kStates, kStates) + draw(kStates, kStates) / 15.0;
    phi.topRows(kKnown).setZero();
    phi.topLeftCorner(kKnown, kKnown).setIdentity();
    Matrix n = Matrix::Zero(kStates, kStates);
    n.block(kKnown, 0, kStates - kKnown, kNoise) = draw(kStates - kKnown, kNoise) / 3.0;
    if (k == kRestart) {
      phi.setIdentity();
      phi.block<2, 2>(index::bias, index::bias).setZero();
      n.setZero();
      n.block<2, 2>(index::bias, 0).setIdentity();
    }
    by_unknowns.push_back(phi * by_unknowns.back());
    by_unknowns.back().middleCols((k + 1) * kStates, kStates) += n;
    constant.push_back(phi * constant.back());

    record.phi = phi;
    record.q = n * n.transpose();
    record.predicted = phi * record.x;
    records.push_back(record);
    record.x = record.predicted;
    record.covariance = (phi * record.covariance * phi.transpose() + n * n.transpose()).eval();
    // The smoother need not know how a state started anew.
    if (k == kRestart) records.back().q.setZero();
  }
  records.push_back(record);

  const Result<std::vector<SmoothedState>> smoothed = smooth(records);
  ASSERT_TRUE(smoothed);
  ASSERT_EQ(smoothed->size(), records.size());
  const Eigen::LDLT<Matrix> solver(information);
  const Vector solution = solver.solve(right);
  for (std::size_t k = 0; k < records.size(); ++k) {
    const Vector x = constant[k] + by_unknowns[k] * solution;
    const Matrix P = by_unknowns[k] * solver.solve(by_unknowns[k].transpose());
    EXPECT_LT(((*smoothed)[k].x - x).norm(), 1e-9 * x.norm()) << k;
    EXPECT_LT(((*smoothed)[k].covariance - P).norm(), 1e-9 * P.norm()) << k;
    EXPECT_LT(largest_growth((*smoothed)[k].covariance, records[k].covariance), 1e-9) << k;
    if (k + 1 < records.size()) {
      EXPECT_GT((records[k].x - x).norm(), 1e-3 * x.norm()) << "or nothing was smoothed";
    }
  }
}

TEST(Smoother, RefusesWhatIsNoRecord) {
  EXPECT_TRUE(smooth({})->empty());
  FilterRecord good;
  good.epoch = departure();
  good.covariance.setIdentity();
  EXPECT_TRUE(smooth({good, good}));
  FilterRecord bad = good;
  bad.x[3] = std::nan("");
  EXPECT_FALSE(smooth({good, bad}));
  bad = good;
  bad.covariance(4, 4) = -1.0;
  EXPECT_FALSE(smooth({bad, good}));
  bad = good;
  bad.epoch = good.epoch - Duration::seconds(1.0);
  EXPECT_FALSE(smooth({good, bad}));
}

TEST(Smoother, LeavesWhatIsBeforeACutAsItWas) {
  FilterRecord before;
  before.epoch = departure();
  before.covariance.setIdentity();
  before.phi.setZero();
  FilterRecord after = before;
  after.x.setConstant(100.0);
  after.covariance *= 1e-4;
  const auto smoothed = smooth({before, after});
  ASSERT_TRUE(smoothed);
  EXPECT_EQ((*smoothed)[0].x, before.x);
  EXPECT_EQ((*smoothed)[0].covariance, before.covariance);
}

// ---- on the way to Mars

const Duration kCycle = Duration::days(10.0);
const Duration kSecondWindow = Duration::seconds(3600.0 + 25.0 * 60.0);
const Duration kCoast = Duration::days(5.0);
constexpr double kPixel = 0.05, kCross = 1.3 * kArcsecond, kRoll = 9.0 * kArcsecond;

FilterSettings settings_of_the_flight() {
  FilterSettings settings;
  settings.camera = twenty_degree_camera();
  settings.process.reflectivity_area_m2 = 0.0;
  settings.sight.centre_of_light = false;
  settings.focal.sigma = settings.k1.sigma = 0.0;
  settings.bias = {.sigma = 0.02, .tau_s = 1000.0 * 86400.0};
  return settings;
}

// What flies: a Gauss-Markov acceleration drawn every two hours, a
// line-of-sight bias for each window. Without random numbers, what the filter
// would call nominal.
class Flight {
 public:
  Flight(const FilterSettings& settings, RandomStream* random)
      : settings_(settings), random_(random), state_(cruise_start().state), epoch_(cruise_start().epoch) {
    for (double& a : xi_a_) a = settings_.process.acceleration.sigma * normal();
  }
  double normal() { return random_ ? random_->normal() : 0.0; }
  const State& state() const { return state_; }
  void move_to(Epoch epoch) {
    while (epoch_ < epoch) {
      const Duration h = std::min(epoch - epoch_, Duration::seconds(7200.0));
      const GaussMarkov& law = settings_.process.acceleration;
      const double phi = std::exp(-h.seconds() / law.tau_s);
      const Vec3 before = xi_a_;
      for (double& a : xi_a_) a = phi * a + law.sigma * std::sqrt(1.0 - phi * phi) * normal();
      const Vec3 after = xi_a_;
      state_ =
          fly(state_, epoch_, h, 0.0, [&](double t) -> Vec3 { return before + (after - before) * (t / h.seconds()); });
      epoch_ = epoch_ + h;
    }
  }
  void start_window() { bias_ = settings_.bias.sigma * Vec2(normal(), normal()); }
  BeaconMeasurement photograph(BodyId body) {
    const Vec3 direction = exact_direction(state_, body, epoch_);
    const Mat3 R = pointed_at(direction, settings_.camera, {150.0, -100.0}, 0.3);
    const Vec2 pixel =
        project(settings_.camera, R * direction).value().vec() + bias_ + kPixel * Vec2(normal(), normal());
    BeaconMeasurement m;
    m.body = body;
    m.mid_exposure = epoch_;
    m.pixel = {pixel.x(), pixel.y()};
    m.pixel_covariance_px2 = kPixel * kPixel * Mat2::Identity();
    m.R_CN = rotation_exp(Vec3(kCross * normal(), kCross * normal(), kRoll * normal())) * R;
    m.attitude_covariance_rad2 = Vec3(kCross * kCross, kCross * kCross, kRoll * kRoll).asDiagonal();
    return m;
  }

 private:
  FilterSettings settings_;
  RandomStream* random_;
  State state_;
  Epoch epoch_;
  Vec3 xi_a_;
  Vec2 bias_ = Vec2::Zero();
};

struct Mark {
  std::size_t record;
  State truth;
};
struct Flown {
  std::vector<FilterRecord> records;
  std::vector<Mark> marks;  // after each second window, and half way to the next cycle
};

// The two planets, 35 degrees from the Sun or more, whose sights place the
// spacecraft best.
std::array<BodyId, 2> best_pair(const State& observer, Epoch epoch) {
  const Vec3 sun = barycentric(body::sun, epoch).p_m - observer.p_m;
  std::vector<std::pair<BodyId, Vec3>> seen;
  for (const BodyId body : {body::mercury, body::venus, body::earth, body::mars, body::jupiter, body::saturn}) {
    const Vec3 d = barycentric(body, epoch).p_m - observer.p_m;
    if (angle_between(d, sun) > 35.0 * kDegree) seen.emplace_back(body, d);
  }
  std::array<BodyId, 2> best{};
  double least = 1e300;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    for (std::size_t j = i + 1; j < seen.size(); ++j) {
      const double w1 = 1.0 / seen[i].second.squaredNorm(), w2 = 1.0 / seen[j].second.squaredNorm();
      const double sine = std::sin(angle_between(seen[i].second, seen[j].second));
      const double trace = 1.0 / (w1 + w2) + (w1 + w2) / (w1 * w2 * sine * sine);
      if (trace < least) best = {seen[i].first, seen[j].first}, least = trace;
    }
  }
  return best;
}

// Two windows every ten days. Known well enough from the start that the sights
// are linear, with the Earth only a million kilometres away: what an extended
// Kalman filter makes of a bad start no smoother can mend.
constexpr double kStartPosition_m = 1e6, kStartVelocity_m_s = 1.0;
Flown flown(const FilterSettings& settings, int cycles, int images, Duration image_period, RandomStream* random) {
  Flight flight(settings, random);
  State guess = flight.state();
  for (double& p : guess.p_m) p += kStartPosition_m * flight.normal();
  for (double& v : guess.v_m_s) v += kStartVelocity_m_s * flight.normal();
  Mat6 P = Mat6::Zero();
  P.diagonal() << Vec3::Constant(kStartPosition_m * kStartPosition_m),
      Vec3::Constant(kStartVelocity_m_s * kStartVelocity_m_s);
  RecordedFilter filter(settings, kernel());
  const Epoch start = cruise_start().epoch;
  EXPECT_TRUE(filter.initialise({start, guess, P}));
  Flown out;
  const auto mark = [&] { out.marks.push_back({filter.records().size() - 1, flight.state()}); };
  for (int cycle = 0; cycle < cycles; ++cycle) {
    flight.move_to(start + kCycle * cycle);
    const std::array<BodyId, 2> pair = best_pair(flight.state(), start + kCycle * cycle);
    for (const bool second : {false, true}) {
      for (int image = 0; image < images; ++image) {
        const Epoch epoch = start + kCycle * cycle + (second ? kSecondWindow : Duration()) + image_period * image;
        flight.move_to(epoch);
        if (image == 0) flight.start_window();
        filter.update(flight.photograph(pair[second ? 1 : 0]));
      }
    }
    mark();
    flight.move_to(start + kCycle * cycle + kCoast);
    EXPECT_TRUE(filter.propagate_to(start + kCycle * cycle + kCoast));
    mark();
  }
  out.records = filter.records();
  return out;
}

TEST(RecordedFilter, IsTheFilterItself) {
  const FilterSettings settings = settings_of_the_flight();
  RandomStream random({.seed = 3, .sample = 0, .purpose = "flight"});
  Flight flight(settings, &random);
  Mat6 P = Mat6::Zero();
  P.diagonal() << Vec3::Constant(1e14), Vec3::Constant(1e4);
  Filter plain(settings, kernel());
  RecordedFilter recorded(settings, kernel());
  const Epoch start = cruise_start().epoch;
  const InitialState initial{start, cruise_start().state, P};
  ASSERT_TRUE(plain.initialise(initial));
  ASSERT_TRUE(recorded.initialise(initial));
  for (int image = 0; image < 6; ++image) {
    flight.move_to(start + Duration::days(0.5 * image));
    const BeaconMeasurement m = flight.photograph(body::earth);
    const UpdateResult a = plain.update(m), b = recorded.update(m);
    EXPECT_EQ(a.accepted, b.accepted);
    EXPECT_EQ(a.window_started, b.window_started);
  }
  ASSERT_TRUE(plain.kick({1.0, 2.0, 3.0}, 0.5));
  ASSERT_TRUE(recorded.kick({1.0, 2.0, 3.0}, 0.5));
  EXPECT_FALSE(recorded.propagate_to(start));
  // Rounding alone: what the gains (1e7 m over 0.05 px) make of 1e-16 of 1e11 m depends on the compiler.
  EXPECT_LT((plain.state().p_m - recorded.filter().state().p_m).norm(), 0.05);
  EXPECT_LT((plain.covariance_pv() - recorded.filter().covariance_pv()).norm(), 1e-9 * plain.covariance_pv().norm());

  // What a record says of the way to the next is what the filter went.
  for (std::size_t i = 0; i + 1 < recorded.records().size(); ++i) {
    const FilterRecord& from = recorded.records()[i];
    EXPECT_LE(from.epoch, recorded.records()[i + 1].epoch);
    EXPECT_LT(largest_growth(recorded.records()[i + 1].covariance,
                             from.phi * from.covariance * from.phi.transpose() + from.q +
                                 StateMatrix(StateVector::Unit(index::bias).asDiagonal()) +
                                 StateMatrix(StateVector::Unit(index::bias + 1).asDiagonal())),
              1e-9);
  }
}

// A push that was not known better than 0.5 m/s is known afterwards, and so is
// the state before it.
TEST(RecordedFilter, SmoothesAcrossAPush) {
  const FilterSettings settings = settings_of_the_flight();
  Mat6 P = Mat6::Zero();
  P.diagonal() << Vec3::Constant(1e10), Vec3::Constant(1e-2);
  RecordedFilter filter(settings, kernel());
  ASSERT_TRUE(filter.initialise({cruise_start().epoch, cruise_start().state, P}));
  ASSERT_TRUE(filter.kick({1.0, 0.0, 0.0}, 0.5));
  ASSERT_EQ(filter.records().size(), 2u);
  const auto smoothed = smooth(filter.records());
  ASSERT_TRUE(smoothed);
  // Nothing came after it, so nothing is known better.
  EXPECT_LT(((*smoothed)[0].x - filter.records()[0].x).norm(), 1e-3);
  EXPECT_NEAR((*smoothed)[0].covariance(3, 3), 1e-2, 1e-9);
  EXPECT_NEAR((*smoothed)[1].covariance(3, 3), 0.26, 1e-9);
}

// 48 runs of 8 cycles. NEES by Student's law over the means of the runs,
// false-alarm probability 1e-3.
TEST(RecordedFilter, SmoothedStatesAreConsistentAndBetter) {
  const FilterSettings settings = settings_of_the_flight();
  constexpr int kRuns = 48, kCycles = 8;
  std::vector<double> nees;
  double filter2 = 0.0, smoothed2 = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random({.seed = 21, .sample = static_cast<std::uint64_t>(run), .purpose = "flight"});
    const Flown arc = flown(settings, kCycles, 12, Duration::seconds(300.0), &random);
    const auto smoothed = smooth(arc.records);
    ASSERT_TRUE(smoothed);
    std::vector<double> squared;
    for (const Mark& mark : arc.marks) {
      const SmoothedState& s = (*smoothed)[mark.record];
      squared.push_back(squared_error(s, mark.truth));
      const std::size_t middle = arc.records.size() / 4;
      if (mark.record < middle || mark.record > 3 * middle) continue;
      filter2 += (arc.records[mark.record].x.head<3>() - mark.truth.p_m).squaredNorm();
      smoothed2 += (s.state().p_m - mark.truth.p_m).squaredNorm();
    }
    nees.push_back(mean(squared));
    if (run > 0) continue;
    for (std::size_t i = 0; i < arc.records.size(); ++i)
      EXPECT_LT(largest_growth((*smoothed)[i].covariance, arc.records[i].covariance), 1e-7) << i;
  }
  const double sigma = standard_deviation(nees) / std::sqrt(static_cast<double>(kRuns));
  EXPECT_NEAR(mean(nees), 6.0, 3.52 * sigma) << "t of 47 degrees at 0.9995";
  EXPECT_LT(sigma, 0.75);  // or the band could not fail
  EXPECT_LT(smoothed2, 0.5 * filter2) << std::sqrt(smoothed2 / filter2);
  RecordProperty("nees", std::to_string(mean(nees)) + " +- " + std::to_string(sigma));
  RecordProperty("rms_ratio", std::to_string(std::sqrt(smoothed2 / filter2)));
}

}  // namespace
}  // namespace astronav::navigation
