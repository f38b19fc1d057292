// SPDX-License-Identifier: Apache-2.0
// The law of one pixel's DN, exact: Poisson, full well, Gaussian read noise, gain, bias, rounding, clipping
// (docs/theory/rendering.md eq. 4). Drawn pixel by pixel, or from alias tables (Walker 1977, built after Vose 1991).
// Internal to this folder.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "foundation/math/random.h"
#include "foundation/math/random_block.h"

namespace astronav::render {

struct DnChain {
  bool shot = true;
  double full_well_e = 0.0;   // infinity where switched off
  double read_noise_e = 0.0;  // 0 where switched off
  double gain_e_dn = 1.0;
  double bias_dn = 0.0;
  int max_dn = 65535;

  std::uint16_t digitise(double electrons) const {
    const double dn = electrons / gain_e_dn + bias_dn + 0.5;
    if (!(dn > 0.0)) return 0;
    return dn >= max_dn ? static_cast<std::uint16_t>(max_dn) : static_cast<std::uint16_t>(dn);
  }
  // Electrons that a pixel of this mean collects, before the well is full.
  double collect(double mean_e, RandomStream& random) const {
    return shot ? static_cast<double>(random.poisson(mean_e)) : mean_e;
  }
  // What is read from these electrons.
  std::uint16_t read(double electrons, RandomStream& random) const {
    if (electrons > full_well_e) electrons = full_well_e;
    if (read_noise_e > 0.0) electrons += read_noise_e * random.normal();
    return digitise(electrons);
  }
  // One draw for a pixel of this expected number of electrons.
  std::uint16_t draw(double mean_e, RandomStream& random) const { return read(collect(mean_e, random), random); }
  // Standard deviation of the draw in electrons, wells not full.
  double noise_e(double mean_e) const;

  bool operator==(const DnChain&) const = default;
};

// Alias tables of laws over at most 1024 values each: a slot of 32 bits holds the threshold (22 bits) and the other
// value (10 bits). One draw costs one random word: its first bits choose the slot, the next 22 the value, so that
// probabilities are right to 2^-22 of a slot.
class AliasTables {
 public:
  AliasTables() = default;
  explicit AliasTables(std::size_t widest_law);
  void add(std::span<const double> probability);
  static constexpr std::size_t kWidest = 1024;

  // Value of law `law` for a random word; the tables as plain numbers, for loops that a compiler makes vectors of.
  static std::uint32_t draw(const std::uint32_t* slots, int bits, std::uint32_t law, std::uint32_t random) {
    const std::uint32_t own = random >> (32 - bits);
    const std::uint32_t slot = slots[(law << bits) + own];
    return ((random << bits) >> 10) < (slot >> 10) ? own : (slot & 1023u);
  }
  const std::uint32_t* slots() const { return slots_.data(); }
  int bits() const { return bits_; }

 private:
  std::vector<std::uint32_t> slots_;
  int bits_ = 1;
};

// Laws for pixels whose means lie between two bounds, in equal steps: for what is nearly the same everywhere.
class EvenLaws {
 public:
  // `step_e` is rounded so that steps fit between the bounds. Nothing where the chain has no shot noise, or where the
  // tables would be too large.
  static std::optional<EvenLaws> make(const DnChain& chain, double lowest_mean_e, double highest_mean_e, double step_e);

  std::size_t levels() const { return levels_; }
  // The level nearest to a mean; not below 0 and below levels() where there is one, otherwise anything.
  double level(double mean_e) const { return (mean_e - lowest_e_) / step_e_ + 0.5; }
  double step_e() const { return step_e_; }
  // One draw for each pixel of these levels. `raised`: for each column of a picture as wide, by how many levels its
  // pixels lie higher (the sum below levels()); empty where none does.
  void draw(std::span<const std::uint16_t> levels, std::span<const std::uint16_t> raised, RandomBlock& random,
            std::uint16_t* out) const;

 private:
  void draw_row(const std::uint16_t* levels, const std::uint16_t* raised, const std::uint32_t* words, std::size_t count,
                std::uint16_t* out) const;

  AliasTables tables_;
  double lowest_e_ = 0.0;
  double step_e_ = 1.0;
  std::size_t levels_ = 0;
  std::uint16_t first_dn_ = 0;
};

// Laws for any mean up to max_mean_e(), in steps of 0.02 of the pixel's noise. A mean between two levels is drawn from
// one or the other, with the probabilities that keep the mean exact; the variance is then too large by at most 1e-4.
class GradedLaws {
 public:
  // Nothing where the chain has no shot noise, or where even dark pixels have too wide a law.
  static std::optional<GradedLaws> make(const DnChain& chain);

  double max_mean_e() const { return max_mean_e_; }
  // One draw for each mean (all between 0 and max_mean_e()).
  void draw(std::span<const float> means_e, RandomBlock& random, std::uint16_t* out) const;

 private:
  AliasTables tables_;
  std::vector<std::uint32_t> first_;  // smallest DN of each level
  // The mean of level i is (root0 + i step)^2 - root0^2.
  double root0_ = 0.0;
  double step_ = 1.0;
  double max_mean_e_ = 0.0;
};

}  // namespace astronav::render
