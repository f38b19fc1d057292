// SPDX-License-Identifier: Apache-2.0
// SPK types 5 (conics between discrete states), 15 (one conic that precesses) and 17 (equinoctial elements).
#include <algorithm>
#include <cmath>

#include "models/ephemeris/spk_segment.h"

namespace astronav::spk {
namespace {

// Stumpff's functions c2 and c3.
struct Stumpff {
  double c2;
  double c3;
};
Stumpff stumpff(double z) {
  if (std::abs(z) < 1e-2) {
    // Series to z^5: the next terms are below 1e-22.
    double c2 = 0.0, c3 = 0.0, term2 = 0.5, term3 = 1.0 / 6.0;
    for (int k = 1; k <= 6; ++k) {
      c2 += term2;
      c3 += term3;
      term2 *= -z / ((2.0 * k + 1.0) * (2.0 * k + 2.0));
      term3 *= -z / ((2.0 * k + 2.0) * (2.0 * k + 3.0));
    }
    return {c2, c3};
  }
  if (z > 0.0) {
    const double r = std::sqrt(z);
    return {(1.0 - std::cos(r)) / z, (r - std::sin(r)) / (z * r)};
  }
  const double r = std::sqrt(-z);
  return {(std::cosh(r) - 1.0) / -z, (std::sinh(r) - r) / (-z * r)};
}

// Kepler's motion by universal variables; the equation is solved by Laguerre's method, which converges from anywhere
// (Conway 1986, Celestial Mechanics 39, 199).
StateKm propagate(const StateKm& start, double gm, double dt) {
  const double r0 = start.p.norm();
  const double sigma = start.p.dot(start.v) / std::sqrt(gm);
  const double alpha = 2.0 / r0 - start.v.squaredNorm() / gm;                             // 1 / semi-major axis
  if (alpha > 0.0) dt = std::remainder(dt, 2.0 * kPi / (std::sqrt(gm * alpha) * alpha));  // whole revolutions
  const double root = std::sqrt(gm);
  const double wanted = root * dt;
  double x = alpha > 0.0 ? wanted * alpha : wanted / r0;
  Stumpff c{};
  double r = r0;
  constexpr int kMaxIterations = 60;
  for (int i = 0; i < kMaxIterations; ++i) {
    const double z = alpha * x * x;
    c = stumpff(z);
    const double f = sigma * x * x * c.c2 + (1.0 - alpha * r0) * x * x * x * c.c3 + r0 * x - wanted;
    r = sigma * x * (1.0 - z * c.c3) + (1.0 - alpha * r0) * x * x * c.c2 + r0;
    const double slope = sigma * (1.0 - z * c.c2) + (1.0 - alpha * r0) * x * (1.0 - z * c.c3);  // dr/dx
    constexpr double n = 5.0;
    const double under = (n - 1.0) * (n - 1.0) * r * r - n * (n - 1.0) * f * slope;
    const double step = n * f / (r + std::copysign(std::sqrt(std::abs(under)), r));
    x -= step;
    if (!(std::abs(step) > 1e-15 * std::abs(x))) break;
  }
  const double z = alpha * x * x;
  c = stumpff(z);
  r = sigma * x * (1.0 - z * c.c3) + (1.0 - alpha * r0) * x * x * c.c2 + r0;
  const double f = 1.0 - x * x * c.c2 / r0;
  const double g = dt - x * x * x * c.c3 / root;
  const double f_rate = root / (r * r0) * x * (z * c.c3 - 1.0);
  const double g_rate = 1.0 - x * x * c.c2 / r;
  return {f * start.p + g * start.v, f_rate * start.p + g_rate * start.v};
}

Vec3 turned(const Vec3& v, const Vec3& axis, double angle) {
  return v * std::cos(angle) + axis.cross(v) * std::sin(angle) + axis * (axis.dot(v) * (1.0 - std::cos(angle)));
}

}  // namespace

// Both neighbours are propagated to the moment; a cosine leads from one to the other.
Result<StateKm> discrete_conics(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  const auto count = static_cast<std::size_t>(segment.record_count);
  const std::size_t epochs = 6 * count;
  const double gm = words[word_count(segment) - 2];
  const std::size_t after = times_before(words, epochs, count, at, true);
  const auto state = [&](std::size_t i) { return StateKm{words.vector(6 * i), words.vector(6 * i + 3)}; };
  const auto from = [&](std::size_t i) { return propagate(state(i), gm, at.since(words[epochs + i])); };
  if (after == 0) return from(0);
  if (after == count) return from(count - 1);
  const StateKm first = from(after - 1), second = from(after);
  const double between = words[epochs + after] - words[epochs + after - 1];
  const double phase = kPi * at.since(words[epochs + after - 1]) / between;
  const double weight = 0.5 + 0.5 * std::cos(phase);
  const double weight_rate = -0.5 * std::sin(phase) * kPi / between;
  return StateKm{weight * first.p + (1.0 - weight) * second.p,
                 weight * first.v + (1.0 - weight) * second.v + weight_rate * (first.p - second.p)};
}

// The oblateness J2 of the central body turns the line of nodes and that of apsides at their mean rates; the velocity
// is that of the conic, turned with it.
Result<StateKm> precessing_conic(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  const double dt = at.since(words[0]);
  const Vec3 pole = words.vector(1).normalized(), periapsis = words.vector(4).normalized();
  const double p = words[7], e = words[8], flag = words[9];
  const Vec3 axis = words.vector(10).normalized();
  const double gm = words[13], j2 = words[14], radius = words[15];
  if (!(p > 0.0) || !(e >= 0.0) || !(gm > 0.0))
    return daf::corrupt("byte {0}: no conic has the semi-latus rectum {1} and the eccentricity {2}",
                        byte_of(segment, 7), p, e);
  const double nearest = p / (1.0 + e);
  const StateKm start{nearest * periapsis, std::sqrt(gm / p) * (1.0 + e) * pole.cross(periapsis)};
  StateKm out = propagate(start, gm, dt);
  if (flag == 3.0 || j2 == 0.0 || e >= 1.0 || nearest <= radius) return out;
  const double one_minus_e2 = 1.0 - e * e;
  const double mean_anomaly = one_minus_e2 / p * std::sqrt(gm * one_minus_e2 / p) * dt;
  // The true anomaly with its whole revolutions.
  const double within = std::atan2(out.p.dot(pole.cross(periapsis)), out.p.dot(periapsis));
  const double anomaly = within + 2.0 * kPi * std::round((mean_anomaly - within) / (2.0 * kPi));
  const double z = anomaly * 1.5 * j2 * (radius / p) * (radius / p);
  const double cos_i = axis.dot(pole);
  if (flag != 1.0) {
    const double apsides = z * (2.5 * cos_i * cos_i - 0.5);
    out = {turned(out.p, pole, apsides), turned(out.v, pole, apsides)};
  }
  if (flag != 2.0) {
    const double node = -z * cos_i;
    out = {turned(out.p, axis, node), turned(out.v, axis, node)};
  }
  return out;
}

// Broucke & Cefola 1972 (Celestial Mechanics 5, 303): h = e sin(w + W), k = e cos(w + W), p = tan(i/2) sin W,
// q = tan(i/2) cos W, and the mean longitude, all of them turning at constant rates.
Result<StateKm> equinoctial_elements(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  const double dt = at.since(words[0]);
  const double a = words[1], h0 = words[2], k0 = words[3], longitude0 = words[4], p0 = words[5], q0 = words[6];
  const double apsides_rate = words[7], longitude_rate = words[8], node_rate = words[9];
  const double ra = words[10], dec = words[11];
  if (!(a > 0.0) || !(h0 * h0 + k0 * k0 < 0.81))
    return daf::corrupt("byte {0}: semi-major axis {1}; it must be positive, and the eccentricity below 0.9",
                        byte_of(segment, 1), a);
  const double ca = std::cos(apsides_rate * dt), sa = std::sin(apsides_rate * dt);
  const double h = h0 * ca + k0 * sa, k = k0 * ca - h0 * sa;
  const double h_rate = apsides_rate * k, k_rate = -apsides_rate * h;
  const double cn = std::cos(node_rate * dt), sn = std::sin(node_rate * dt);
  const double p = p0 * cn + q0 * sn, q = q0 * cn - p0 * sn;
  const double p_rate = node_rate * q, q_rate = -node_rate * p;

  // Kepler's equation L = F + h cos F - k sin F by Newton's method; e < 0.9 bounds the steps.
  const double longitude = std::remainder(longitude0 + longitude_rate * dt, 2.0 * kPi);
  double f = longitude;
  constexpr int kMaxIterations = 50;
  for (int i = 0; i < kMaxIterations; ++i) {
    const double step = (f + h * std::cos(f) - k * std::sin(f) - longitude) / (1.0 - h * std::sin(f) - k * std::cos(f));
    f -= std::clamp(step, -0.5, 0.5);
    if (!(std::abs(step) > 1e-15)) break;
  }
  const double sf = std::sin(f), cf = std::cos(f);
  const double f_rate = (longitude_rate - h_rate * cf + k_rate * sf) / (1.0 - h * sf - k * cf);

  // In the plane of the orbit, and the rates of that.
  const double root = std::sqrt(1.0 - h * h - k * k);
  const double b = 1.0 / (1.0 + root);
  const double b_rate = b * b * (h * h_rate + k * k_rate) / root;
  const double x = a * ((1.0 - h * h * b) * cf + h * k * b * sf - k);
  const double y = a * ((1.0 - k * k * b) * sf + h * k * b * cf - h);
  const double hkb_rate = (h_rate * k + h * k_rate) * b + h * k * b_rate;
  const double x_rate = a * (-(2.0 * h * h_rate * b + h * h * b_rate) * cf - (1.0 - h * h * b) * sf * f_rate +
                             hkb_rate * sf + h * k * b * cf * f_rate - k_rate);
  const double y_rate = a * (-(2.0 * k * k_rate * b + k * k * b_rate) * sf + (1.0 - k * k * b) * cf * f_rate +
                             hkb_rate * cf - h * k * b * sf * f_rate - h_rate);
  const double d = 1.0 / (1.0 + p * p + q * q);
  const double d_rate = -2.0 * d * d * (p * p_rate + q * q_rate);
  const Vec3 u(1.0 - p * p + q * q, 2.0 * p * q, -2.0 * p), w(2.0 * p * q, 1.0 + p * p - q * q, 2.0 * q);
  const Vec3 u_rate(-2.0 * p * p_rate + 2.0 * q * q_rate, 2.0 * (p_rate * q + p * q_rate), -2.0 * p_rate);
  const Vec3 w_rate(2.0 * (p_rate * q + p * q_rate), 2.0 * p * p_rate - 2.0 * q * q_rate, 2.0 * q_rate);
  const Vec3 place = d * (x * u + y * w);
  const Vec3 rate = d * (x_rate * u + y_rate * w + x * u_rate + y * w_rate) + d_rate * (x * u + y * w);

  // From the equator of the elements, whose pole stands at (ra, dec).
  Mat3 frame;
  frame << -std::sin(ra), -std::cos(ra) * std::sin(dec), std::cos(ra) * std::cos(dec), std::cos(ra),
      -std::sin(ra) * std::sin(dec), std::sin(ra) * std::cos(dec), 0.0, std::cos(dec), std::sin(dec);
  return StateKm{frame * place, frame * rate};
}

}  // namespace astronav::spk
