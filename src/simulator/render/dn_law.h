// SPDX-License-Identifier: Apache-2.0
// The law of one pixel's DN, exact: Poisson, full well, Gaussian read noise, gain, bias, rounding, clipping
// (docs/theory/rendering.md eq. 4). Drawn pixel by pixel, or from alias tables for many pixels of the same few means.
// Internal to this folder.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "foundation/math/random.h"

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
  // One draw for a pixel of this expected number of electrons.
  std::uint16_t draw(double mean_e, RandomStream& random) const {
    double electrons = shot ? static_cast<double>(random.poisson(mean_e)) : mean_e;
    if (electrons > full_well_e) electrons = full_well_e;
    if (read_noise_e > 0.0) electrons += read_noise_e * random.normal();
    return digitise(electrons);
  }
};

// Laws for several means, as alias tables (Walker 1977, built after Vose 1991).
class DnTables {
 public:
  // True where tables for these means would be larger or slower to make than they are worth.
  static bool too_costly(const DnChain& chain, double lowest_mean_e, double highest_mean_e, std::size_t levels);

  DnTables() = default;
  DnTables(const DnChain& chain, std::span<const double> means_e);

  // One draw for each pixel of these levels.
  void draw(std::span<const std::uint16_t> levels, RandomStream& random, std::uint16_t* out) const;

 private:
  struct Slot {
    std::uint32_t threshold = 0;
    std::uint16_t own = 0;
    std::uint16_t other = 0;
  };
  void add_level(std::span<const double> probability, int first_dn);

  std::vector<Slot> slots_;
  int slot_bits_ = 1;
};

}  // namespace astronav::render
