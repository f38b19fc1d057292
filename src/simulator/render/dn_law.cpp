// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/dn_law.h"

#if defined(__AVX512F__) && defined(__AVX512BW__)
#include <immintrin.h>
#endif

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "foundation/base/check.h"

namespace astronav::render {
namespace {

// Beyond this many sigma a law holds less than 2^-39.
constexpr double kReach = 7.0;
constexpr double kLeastPoisson = 1e-13;
// Sizes of tables.
constexpr std::size_t kMaxLevels = 4096;
constexpr double kMaxProducts = 5e7;  // to make them: less than a tenth of a second
constexpr double kGradedStep = 0.02;  // of the noise
constexpr double kGradedMaxMean = 1500.0;
constexpr long kGradedWidest = 256;  // values of a law: the tables of small means have to stay in the cache

double normal_cdf(double x) {
  return 0.5 * std::erfc(-x * 0.70710678118654752440);
}

// From lowest to highest electrons that a Poisson law can bring (a little wider than kReach, for its skewness).
struct Span {
  long first;
  long last;
  long size() const { return last - first + 1; }
};
Span electrons_of(double lowest_mean_e, double highest_mean_e) {
  const double down = kReach * std::sqrt(lowest_mean_e) + 2.0;
  const double up = kReach * std::sqrt(highest_mean_e) + 20.0;
  return {std::max(0L, static_cast<long>(lowest_mean_e - down)), static_cast<long>(highest_mean_e + up)};
}

// From lowest to highest DN; of a chain with shot noise, as all that follows.
Span dn_of(const DnChain& chain, double lowest_mean_e, double highest_mean_e) {
  const Span electrons = electrons_of(lowest_mean_e, highest_mean_e);
  const double reach = kReach * chain.read_noise_e;
  return {chain.digitise(std::min(static_cast<double>(electrons.first), chain.full_well_e) - reach),
          chain.digitise(std::min(static_cast<double>(electrons.last), chain.full_well_e) + reach)};
}

// Where a law of this mean is seen at all: seven of its sigmas, which is narrower than what dn_of() gives.
Span dn_of_law(const DnChain& chain, double mean_e) {
  const Span widest = dn_of(chain, mean_e, mean_e);
  const double reach = (kReach + 0.5) * chain.noise_e(mean_e) + 8.0;
  return {std::max<long>(widest.first, chain.digitise(std::min(mean_e, chain.full_well_e) - reach)),
          std::min<long>(widest.last, chain.digitise(mean_e + reach))};
}

// P(DN) for any mean within bounds (docs/theory/rendering.md eq. 5). The read-out of each number of electrons is
// computed once.
class LawMaker {
 public:
  LawMaker(const DnChain& chain, double lowest_mean_e, double highest_mean_e)
      : chain_(chain), electrons_(electrons_of(lowest_mean_e, highest_mean_e)) {
    const auto count = static_cast<std::size_t>(electrons_.size());
    read_.resize(count);
    log_factorial_.resize(count);
    for (std::size_t k = 0; k < count; ++k) {
      const double n = static_cast<double>(electrons_.first) + static_cast<double>(k);
      log_factorial_[k] = std::lgamma(n + 1.0);
      read_[k] = read_out(n);
    }
  }

  // Probabilities of first_dn, first_dn + 1, ...; the outermost take what lies beyond them.
  void law(double mean_e, long first_dn, std::span<double> out) const {
    std::fill(out.begin(), out.end(), 0.0);
    const Span here = electrons_of(mean_e, mean_e);
    const double log_mean = mean_e > 0.0 ? std::log(mean_e) : 0.0;
    for (long n = std::max(here.first, electrons_.first); n <= std::min(here.last, electrons_.last); ++n) {
      const auto k = static_cast<std::size_t>(n - electrons_.first);
      const double poisson = mean_e > 0.0 ? std::exp(static_cast<double>(n) * log_mean - mean_e - log_factorial_[k])
                                          : (n == 0 ? 1.0 : 0.0);
      if (poisson >= kLeastPoisson) add(read_[k], poisson, first_dn, out);
    }
  }

 private:
  struct ReadOut {
    long first_dn = 0;
    std::vector<double> probability;
  };
  ReadOut read_out(double well) const {
    well = std::min(well, chain_.full_well_e);
    const double reach = kReach * chain_.read_noise_e;
    ReadOut out;
    out.first_dn = chain_.digitise(well - reach);
    const long last = chain_.digitise(well + reach);
    double below = 0.0;
    for (long dn = out.first_dn; dn <= last; ++dn) {
      const double edge_e = (static_cast<double>(dn) + 0.5 - chain_.bias_dn) * chain_.gain_e_dn;
      const double up_to = dn == last ? 1.0 : normal_cdf((edge_e - well) / chain_.read_noise_e);
      out.probability.push_back(up_to - below);
      below = up_to;
    }
    return out;
  }
  static void add(const ReadOut& read, double weight, long first_dn, std::span<double> out) {
    const long last = static_cast<long>(out.size()) - 1;
    for (std::size_t i = 0; i < read.probability.size(); ++i) {
      const long at = std::clamp(read.first_dn + static_cast<long>(i) - first_dn, 0L, last);
      out[static_cast<std::size_t>(at)] += weight * read.probability[i];
    }
  }

  DnChain chain_;
  Span electrons_;
  std::vector<ReadOut> read_;
  std::vector<double> log_factorial_;
};

double products(const DnChain& chain, double mean_e, double levels) {
  const double read_width = 2.0 * kReach * chain.read_noise_e / chain.gain_e_dn + 2.0;
  return levels * read_width * static_cast<double>(electrons_of(mean_e, mean_e).size());
}

}  // namespace

double DnChain::noise_e(double mean_e) const {
  return std::sqrt((shot ? mean_e : 0.0) + read_noise_e * read_noise_e + gain_e_dn * gain_e_dn / 12.0);
}

AliasTables::AliasTables(std::size_t widest_law)
    : bits_(std::max(1, static_cast<int>(std::bit_width(std::max<std::size_t>(widest_law, 2) - 1)))) {
  ASTRONAV_CHECK(widest_law <= kWidest);
}

void AliasTables::add(std::span<const double> probability) {
  const std::size_t count = std::size_t{1} << bits_;
  ASTRONAV_CHECK(probability.size() <= count);
  double sum = 0.0;
  for (const double p : probability) sum += p;
  std::array<double, kWidest> share{};  // of a slot's width
  std::vector<std::size_t> small;
  std::vector<std::size_t> large;
  for (std::size_t i = 0; i < count; ++i) {
    if (i < probability.size()) share[i] = probability[i] / sum * static_cast<double>(count);
    (share[i] < 1.0 ? small : large).push_back(i);
  }
  const std::size_t base = slots_.size();
  slots_.resize(base + count);
  while (!small.empty() && !large.empty()) {
    const std::size_t s = small.back();
    const std::size_t l = large.back();
    small.pop_back();
    const double threshold = std::min(std::floor(share[s] * 0x1p22 + 0.5), 0x1p22 - 1.0);
    slots_[base + s] = static_cast<std::uint32_t>(threshold) << 10 | static_cast<std::uint32_t>(l);
    share[l] -= 1.0 - share[s];
    if (share[l] < 1.0) {
      large.pop_back();
      small.push_back(l);
    }
  }
  // What rounding left over keeps its own value.
  for (const auto* rest : {&small, &large}) {
    for (const std::size_t i : *rest) slots_[base + i] = 0xfffffc00u | static_cast<std::uint32_t>(i);
  }
}

std::optional<EvenLaws> EvenLaws::make(const DnChain& chain, double lowest_mean_e, double highest_mean_e,
                                       double step_e) {
  if (!chain.shot) return {};
  const Span dn = dn_of(chain, lowest_mean_e, highest_mean_e);
  if (dn.size() > static_cast<long>(AliasTables::kWidest)) return {};
  const double wanted = std::ceil((highest_mean_e - lowest_mean_e) / step_e) + 1.0;
  if (!(wanted <= static_cast<double>(kMaxLevels)) || products(chain, highest_mean_e, wanted) > kMaxProducts) return {};
  EvenLaws made;
  made.levels_ = static_cast<std::size_t>(wanted);
  made.lowest_e_ = lowest_mean_e;
  made.step_e_ = made.levels_ > 1 ? (highest_mean_e - lowest_mean_e) / (wanted - 1.0) : std::max(step_e, 1e-9);
  made.first_dn_ = static_cast<std::uint16_t>(dn.first);
  const auto width = static_cast<std::size_t>(dn.size());
  made.tables_ = AliasTables(width);
  const LawMaker maker(chain, lowest_mean_e, highest_mean_e);
  std::vector<double> law(width);
  for (std::size_t i = 0; i < made.levels_; ++i) {
    maker.law(lowest_mean_e + made.step_e_ * static_cast<double>(i), dn.first, law);
    made.tables_.add(law);
  }
  return made;
}

void EvenLaws::draw_row(const std::uint16_t* levels, const std::uint16_t* raised, const std::uint32_t* words,
                        std::size_t count, std::uint16_t* out) const {
  const std::uint32_t* const slots = tables_.slots();
  const int bits = tables_.bits();
  const std::uint32_t first = first_dn_;
  std::size_t i = 0;
#if defined(__AVX512F__) && defined(__AVX512BW__)
  // The loop below, sixteen pixels at once. GCC 12 picks a table's values one by one, which takes twice the time.
  const __m128i own_bits = _mm_cvtsi32_si128(bits);
  const __m128i other_bits = _mm_cvtsi32_si128(32 - bits);
  const __m512i value_bits = _mm512_set1_epi32(1023);
  const __m512i first_of_all = _mm512_set1_epi32(static_cast<int>(first));
  for (; i + 16 <= count; i += 16) {
    __m512i level = _mm512_cvtepu16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(levels + i)));
    if (raised != nullptr) {
      const __m256i more = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(raised + i));
      level = _mm512_add_epi32(level, _mm512_cvtepu16_epi32(more));
    }
    const __m512i word = _mm512_loadu_si512(words + i);
    const __m512i own = _mm512_srl_epi32(word, other_bits);
    const __m512i slot = _mm512_i32gather_epi32(_mm512_add_epi32(_mm512_sll_epi32(level, own_bits), own), slots, 4);
    const __m512i toss = _mm512_srli_epi32(_mm512_sll_epi32(word, own_bits), 10);
    const __mmask16 keep = _mm512_cmplt_epu32_mask(toss, _mm512_srli_epi32(slot, 10));
    const __m512i value = _mm512_mask_blend_epi32(keep, _mm512_and_si512(slot, value_bits), own);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + i),
                        _mm512_cvtepi32_epi16(_mm512_add_epi32(value, first_of_all)));
  }
#endif
  for (; i < count; ++i) {
    const std::uint32_t level = static_cast<std::uint32_t>(levels[i]) + (raised != nullptr ? raised[i] : 0u);
    out[i] = static_cast<std::uint16_t>(first + AliasTables::draw(slots, bits, level, words[i]));
  }
}

void EvenLaws::draw(std::span<const std::uint16_t> levels, std::span<const std::uint16_t> raised, RandomBlock& random,
                    std::uint16_t* out) const {
  constexpr std::size_t kBlock = 2048;
  std::array<std::uint32_t, kBlock> words;
  const std::size_t width = raised.empty() ? levels.size() : raised.size();
  for (std::size_t row = 0; row < levels.size(); row += width) {
    for (std::size_t begin = 0; begin < width; begin += kBlock) {
      const std::size_t count = std::min(kBlock, width - begin);
      random.fill(std::span(words).first(count));
      draw_row(levels.data() + row + begin, raised.empty() ? nullptr : raised.data() + begin, words.data(), count,
               out + row + begin);
    }
  }
}

std::optional<GradedLaws> GradedLaws::make(const DnChain& chain) {
  if (!chain.shot) return {};
  GradedLaws made;
  made.step_ = 0.5 * kGradedStep;
  const auto steps_to = [&](double mean_e) {
    return std::floor((chain.noise_e(mean_e) - chain.noise_e(0.0)) / made.step_);
  };
  // The law must fit into a table that is soon made, and the well be far from full.
  double highest = std::min(kGradedMaxMean, 0.25 * chain.full_well_e);
  while (highest > 1.0 && (dn_of_law(chain, highest).size() > kGradedWidest ||
                           products(chain, highest, steps_to(highest)) > kMaxProducts)) {
    highest *= 0.7;
  }
  made.root0_ = chain.noise_e(0.0);
  const double offset = made.root0_ * made.root0_;
  const auto steps = static_cast<std::size_t>(steps_to(highest));
  const auto mean = [&](std::size_t i) {
    const double root = made.root0_ + static_cast<double>(i) * made.step_;
    return std::max(0.0, root * root - offset);
  };
  if (steps < 2 || highest <= 1.0) return {};
  std::size_t widest = 2;
  std::vector<Span> spans;
  for (std::size_t i = 0; i <= steps; ++i) {
    spans.push_back(dn_of_law(chain, mean(i)));
    widest = std::max(widest, static_cast<std::size_t>(spans.back().size()));
  }
  made.tables_ = AliasTables(widest);
  const LawMaker maker(chain, 0.0, mean(steps));
  std::vector<double> law;
  for (std::size_t i = 0; i <= steps; ++i) {
    law.resize(static_cast<std::size_t>(spans[i].size()));
    maker.law(mean(i), spans[i].first, law);
    made.tables_.add(law);
    made.first_.push_back(static_cast<std::uint32_t>(spans[i].first));
  }
  made.max_mean_e_ = mean(steps);
  return made;
}

void GradedLaws::draw(std::span<const float> means_e, RandomBlock& random, std::uint16_t* out) const {
  constexpr std::size_t kBlock = 1024;
  std::array<std::uint32_t, 2 * kBlock> words;
  const auto root0 = static_cast<float>(root0_);
  const auto offset = static_cast<float>(root0_ * root0_);
  const auto step = static_cast<float>(step_);
  const auto per_step = static_cast<float>(1.0 / step_);
  const auto last = static_cast<float>(first_.size() - 2);
  const std::uint32_t* const first = first_.data();
  const std::uint32_t* const slots = tables_.slots();
  const int bits = tables_.bits();
  for (std::size_t begin = 0; begin < means_e.size(); begin += kBlock) {
    const std::size_t count = std::min(kBlock, means_e.size() - begin);
    random.fill(std::span(words).first(2 * count));
    const float* const mean = means_e.data() + begin;
    const std::uint32_t* const coins = words.data() + count;
    std::uint16_t* const dn = out + begin;
    for (std::size_t i = 0; i < count; ++i) {
      // Between the levels at root_below^2 and (root_below + step)^2, both less the offset.
      const float root = std::sqrt(mean[i] + offset);
      const auto below = static_cast<std::int32_t>(std::min(std::max((root - root0) * per_step, 0.0f), last));
      const float root_below = root0 + static_cast<float>(below) * step;
      const float share = (root - root_below) * (root + root_below) / (step * (2.0f * root_below + step));
      const float coin = static_cast<float>(coins[i] >> 8) * 0x1p-24f;
      const auto level = static_cast<std::uint32_t>(below + (coin < share ? 1 : 0));
      dn[i] = static_cast<std::uint16_t>(first[level] + AliasTables::draw(slots, bits, level, words[i]));
    }
  }
}

}  // namespace astronav::render
