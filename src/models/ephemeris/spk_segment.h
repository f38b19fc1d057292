// SPDX-License-Identifier: Apache-2.0
// What the segments of SPK kernels hold, after NAIF's "SPK Required Reading". Private to this folder.
//
// read_layout() checks, when a kernel is opened, that every count and every table of a segment lies inside it, so that
// the evaluators may read without looking again. What the numbers themselves say is judged where they are used.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/daf.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::spk {

// Fills in the layout of a segment; corrupt_data with the byte. Types that are not read pass (evaluate() refuses them).
Result<void> read_layout(std::span<const std::byte> file, Ephemeris::Segment& segment);

// State of the segment's target relative to its centre, in the segment's frame, metres. Does not allocate.
Result<void> evaluate(std::span<const std::byte> file, const Ephemeris::Segment& segment, Epoch epoch, State& out);

// The words of a segment, counted from 0.
class Words {
 public:
  Words(std::span<const std::byte> file, const Ephemeris::Segment& segment)
      : first_(file.data() + segment.first_byte), swap_(segment.swap_bytes) {}
  double operator[](std::size_t i) const { return daf::load_double(first_ + i * daf::kWordBytes, swap_); }
  Vec3 vector(std::size_t i) const { return {(*this)[i], (*this)[i + 1], (*this)[i + 2]}; }

 private:
  const std::byte* first_;
  bool swap_;
};
inline std::size_t word_count(const Ephemeris::Segment& segment) {
  return (segment.last_byte + 1 - segment.first_byte) / daf::kWordBytes;
}
inline std::size_t byte_of(const Ephemeris::Segment& segment, std::size_t word) {
  return segment.first_byte + word * daf::kWordBytes;
}

// A moment as whole seconds past J2000 and the rest: one double resolves a tenth of a microsecond only.
struct Moment {
  double whole_s;
  double rest_s;
  explicit Moment(Epoch epoch)
      : whole_s(static_cast<double>(epoch.tdb_nanoseconds() / 1'000'000'000)),
        rest_s(static_cast<double>(epoch.tdb_nanoseconds() % 1'000'000'000) * 1e-9) {}
  double since(double tdb_s) const { return whole_s - tdb_s + rest_s; }
};

// In kilometres, as kernels are.
struct StateKm {
  Vec3 p = Vec3::Zero();
  Vec3 v = Vec3::Zero();
};

// The evaluators of the types, each in a file of its kin.
Result<StateKm> chebyshev_positions(std::span<const std::byte> file, const Ephemeris::Segment& segment, Moment at);
Result<StateKm> chebyshev_velocities(const Words& words, const Ephemeris::Segment& segment, Moment at);  // 20
Result<StateKm> difference_lines(const Words& words, const Ephemeris::Segment& segment, Moment at);      // 1, 21
Result<StateKm> interpolated_states(const Words& words, const Ephemeris::Segment& segment, Moment at);   // 8, 9, 12, 13
Result<StateKm> interpolated_pieces(const Words& words, const Ephemeris::Segment& segment, Moment at);   // 18, 19
Result<StateKm> discrete_conics(const Words& words, const Ephemeris::Segment& segment, Moment at);       // 5
Result<StateKm> precessing_conic(const Words& words, const Ephemeris::Segment& segment, Moment at);      // 15
Result<StateKm> equinoctial_elements(const Words& words, const Ephemeris::Segment& segment, Moment at);  // 17

// How many of `count` increasing times, from the word `first` on, lie before `at` (or at it, with `or_at`).
std::size_t times_before(const Words& words, std::size_t first, std::size_t count, Moment at, bool or_at);

// Checks of the pieces of type 19, which have a layout of their own.
inline constexpr int kMaxWindow = 28;  // SPICE reads polynomials of degree up to 27
Result<void> check_pieces(const Words& words, const Ephemeris::Segment& segment);

}  // namespace astronav::spk
