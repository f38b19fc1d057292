// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/dn_law.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace astronav::render {
namespace {

// Beyond this many sigma a law holds less than 2^-39.
constexpr double kReach = 7.0;

double normal_cdf(double x) {
  return 0.5 * std::erfc(-x * 0.70710678118654752440);
}

// Electrons that a Poisson law of these means can bring (a little wider than kReach, for its skewness).
struct Span {
  long first;
  long last;
};
Span electrons_of(double lowest_mean_e, double highest_mean_e) {
  const double down = kReach * std::sqrt(lowest_mean_e) + 2.0;
  const double up = kReach * std::sqrt(highest_mean_e) + 20.0;
  return {std::max(0L, static_cast<long>(lowest_mean_e - down)), static_cast<long>(highest_mean_e + up)};
}

Span dn_of(const DnChain& chain, double lowest_e, double highest_e) {
  const double reach = kReach * chain.read_noise_e;
  return {chain.digitise(std::min(lowest_e, chain.full_well_e) - reach),
          chain.digitise(std::min(highest_e, chain.full_well_e) + reach)};
}

}  // namespace

bool DnTables::too_costly(const DnChain& chain, double lowest_mean_e, double highest_mean_e, std::size_t levels) {
  const Span electrons = chain.shot ? electrons_of(lowest_mean_e, highest_mean_e) : Span{0, 0};
  const Span dn = chain.shot ? dn_of(chain, static_cast<double>(electrons.first), static_cast<double>(electrons.last))
                             : dn_of(chain, lowest_mean_e, highest_mean_e);
  const double width = static_cast<double>(dn.last - dn.first + 1);
  const double products = width * static_cast<double>(electrons.last - electrons.first + 1);
  return products > 4e6 || products * static_cast<double>(levels) > 4e8 || width * static_cast<double>(levels) > 4e6;
}

DnTables::DnTables(const DnChain& chain, std::span<const double> means_e) {
  const auto [lowest, highest] = std::minmax_element(means_e.begin(), means_e.end());
  const Span electrons = electrons_of(*lowest, *highest);
  const Span dn = chain.shot ? dn_of(chain, static_cast<double>(electrons.first), static_cast<double>(electrons.last))
                             : dn_of(chain, *lowest, *highest);
  const auto dn_count = static_cast<std::size_t>(dn.last - dn.first + 1);
  slot_bits_ = std::max(1, static_cast<int>(std::bit_width(dn_count - 1)));
  slots_.reserve(means_e.size() << slot_bits_);

  // Probability of each DN given the electrons in the well; the outermost DN take what lies beyond them.
  const auto dn_given = [&](double well, double* out) {
    well = std::min(well, chain.full_well_e);
    if (!(chain.read_noise_e > 0.0)) {
      std::fill(out, out + dn_count, 0.0);
      out[chain.digitise(well) - dn.first] = 1.0;
      return;
    }
    double below = 0.0;
    for (std::size_t i = 0; i < dn_count; ++i) {
      const double edge_e =
          (static_cast<double>(dn.first) + static_cast<double>(i) + 0.5 - chain.bias_dn) * chain.gain_e_dn;
      const double up_to = i + 1 == dn_count ? 1.0 : normal_cdf((edge_e - well) / chain.read_noise_e);
      out[i] = up_to - below;
      below = up_to;
    }
  };

  std::vector<double> law(dn_count);
  if (!chain.shot) {
    for (const double mean : means_e) {
      dn_given(mean, law.data());
      add_level(law, static_cast<int>(dn.first));
    }
    return;
  }
  const auto electron_count = static_cast<std::size_t>(electrons.last - electrons.first + 1);
  std::vector<double> given(electron_count * dn_count);
  for (std::size_t k = 0; k < electron_count; ++k) {
    dn_given(static_cast<double>(electrons.first) + static_cast<double>(k), given.data() + k * dn_count);
  }
  for (const double mean : means_e) {
    std::fill(law.begin(), law.end(), 0.0);
    for (std::size_t k = 0; k < electron_count; ++k) {
      const double n = static_cast<double>(electrons.first) + static_cast<double>(k);
      const double poisson = mean > 0.0 ? std::exp(n * std::log(mean) - mean - std::lgamma(n + 1.0)) : (n == 0.0);
      if (poisson < 1e-13) continue;
      for (std::size_t i = 0; i < dn_count; ++i) law[i] += poisson * given[k * dn_count + i];
    }
    add_level(law, static_cast<int>(dn.first));
  }
}

void DnTables::draw(std::span<const std::uint16_t> levels, RandomStream& random, std::uint16_t* out) const {
  const Slot* const slots = slots_.data();
  const int bits = slot_bits_;
  // The choice between a slot's two values is a coin toss, which no branch predictor likes: arithmetic decides.
  const auto one = [=](std::uint16_t level, std::uint32_t r) {
    const Slot slot = slots[(static_cast<std::size_t>(level) << bits) + (r >> (32 - bits))];
    const auto mask = static_cast<std::uint32_t>(-static_cast<std::int32_t>((r << bits) < slot.threshold));
    return static_cast<std::uint16_t>(slot.other ^ ((slot.own ^ slot.other) & mask));
  };
  std::size_t i = 0;
  for (; i + 1 < levels.size(); i += 2) {
    const std::uint64_t r = random.next();
    out[i] = one(levels[i], static_cast<std::uint32_t>(r));
    out[i + 1] = one(levels[i + 1], static_cast<std::uint32_t>(r >> 32));
  }
  if (i < levels.size()) out[i] = one(levels[i], static_cast<std::uint32_t>(random.next()));
}

void DnTables::add_level(std::span<const double> probability, int first_dn) {
  const std::size_t count = std::size_t{1} << slot_bits_;
  double sum = 0.0;
  for (const double p : probability) sum += p;
  std::vector<double> share(count, 0.0);  // of a slot's width
  std::vector<std::size_t> small;
  std::vector<std::size_t> large;
  for (std::size_t i = 0; i < count; ++i) {
    if (i < probability.size()) share[i] = probability[i] / sum * static_cast<double>(count);
    (share[i] < 1.0 ? small : large).push_back(i);
  }
  const std::size_t base = slots_.size();
  const auto dn_at = [&](std::size_t i) {
    return static_cast<std::uint16_t>(first_dn + static_cast<int>(std::min(i, probability.size() - 1)));
  };
  slots_.resize(base + count);
  while (!small.empty() && !large.empty()) {
    const std::size_t s = small.back();
    const std::size_t l = large.back();
    small.pop_back();
    slots_[base + s] = {static_cast<std::uint32_t>(std::min(share[s] * 0x1p32, 0x1p32 - 1.0)), dn_at(s), dn_at(l)};
    share[l] -= 1.0 - share[s];
    if (share[l] < 1.0) {
      large.pop_back();
      small.push_back(l);
    }
  }
  for (const auto* rest : {&small, &large}) {
    for (const std::size_t i : *rest) slots_[base + i] = {0xffffffffu, dn_at(i), dn_at(i)};
  }
}

}  // namespace astronav::render
