// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/pair_index.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

namespace astronav::vision {
namespace {

constexpr char kMagic[8] = {'A', 'N', 'A', 'V', 'P', 'A', 'I', 'R'};
constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kMaxStars = 65535;

struct Header {
  char magic[8];
  std::uint32_t version;
  std::uint32_t stars;
  std::uint32_t pairs;
  std::uint32_t slots;
  double max_angle_rad;
  double radius_rad;
  std::uint32_t neighbours;
  std::uint32_t reserved;
};
static_assert(sizeof(Header) == 48 && sizeof(PairIndex::IndexStar) == 20 && sizeof(PairIndex::Pair) == 4);

}  // namespace

AsterismSettings AsterismSettings::for_field(double fov_h_rad, double fov_v_rad) {
  AsterismSettings settings;
  const double shorter = std::min(fov_h_rad, fov_v_rad);
  settings.radius_rad = 0.25 * shorter;
  settings.max_angle_rad = std::hypot(fov_h_rad, fov_v_rad);
  settings.neighbours = shorter < 7.0 * kDegree ? 2 : 4;
  return settings;
}

std::vector<std::uint32_t> choose_asterism_stars(const StarField& field, const AsterismSettings& settings) {
  const std::span<const FieldStar> all = field.stars();
  std::vector<std::uint32_t> by_brightness(all.size());
  std::iota(by_brightness.begin(), by_brightness.end(), 0u);
  std::stable_sort(by_brightness.begin(), by_brightness.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return all[a].v_mag < all[b].v_mag; });

  std::vector<char> taken(all.size(), 0);
  std::vector<std::uint32_t> chosen, nearby(all.size());
  for (const std::uint32_t i : by_brightness) {
    if (all[i].v_mag > settings.max_v_mag || chosen.size() == kMaxStars) break;
    const std::size_t n = field.cone(all[i].direction_N, settings.radius_rad, nearby);
    int neighbours = 0;
    for (std::size_t k = 0; k < n; ++k) neighbours += taken[nearby[k]];
    if (neighbours >= settings.neighbours) continue;
    taken[i] = 1;
    chosen.push_back(i);
  }
  return chosen;
}

std::vector<std::byte> build_pair_index(const StarField& field, const AsterismSettings& settings) {
  const std::span<const FieldStar> all = field.stars();
  const std::vector<std::uint32_t> chosen = choose_asterism_stars(field, settings);
  std::vector<std::uint32_t> nearby(all.size());
  std::vector<char> taken(all.size(), 0);
  std::vector<std::uint32_t> place(all.size(), 0);
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    place[chosen[k]] = static_cast<std::uint32_t>(k);
    taken[chosen[k]] = 1;
  }
  struct Entry {
    double cosine;
    PairIndex::Pair pair;
  };
  std::vector<Entry> entries;
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    const Vec3& d = all[chosen[k]].direction_N;
    const std::size_t n = field.cone(d, settings.max_angle_rad, nearby);
    for (std::size_t m = 0; m < n; ++m) {
      if (!taken[nearby[m]] || place[nearby[m]] <= k) continue;
      entries.push_back({d.dot(all[nearby[m]].direction_N),
                         {static_cast<std::uint16_t>(k), static_cast<std::uint16_t>(place[nearby[m]])}});
    }
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.cosine < b.cosine; });

  Header header{};
  std::memcpy(header.magic, kMagic, sizeof kMagic);
  header.version = kVersion;
  header.stars = static_cast<std::uint32_t>(chosen.size());
  header.pairs = static_cast<std::uint32_t>(entries.size());
  header.slots = std::max<std::uint32_t>(1, header.pairs / 2);
  header.max_angle_rad = settings.max_angle_rad;
  header.radius_rad = settings.radius_rad;
  header.neighbours = static_cast<std::uint32_t>(settings.neighbours);
  const double cos_first = std::cos(settings.max_angle_rad);
  const double slots_per_cos = header.slots / (1.0 - cos_first);
  std::vector<std::uint32_t> first(header.slots + 1, 0);
  for (const Entry& e : entries) {
    const auto slot = static_cast<std::int64_t>((e.cosine - cos_first) * slots_per_cos);
    ++first[std::clamp<std::int64_t>(slot, 0, header.slots - 1) + 1];
  }
  std::partial_sum(first.begin(), first.end(), first.begin());

  std::vector<std::byte> bytes(sizeof(Header) + chosen.size() * sizeof(PairIndex::IndexStar) + first.size() * 4 +
                               entries.size() * sizeof(PairIndex::Pair));
  std::byte* out = bytes.data();
  const auto put = [&out](const void* from, std::size_t size) {
    std::memcpy(out, from, size);
    out += size;
  };
  put(&header, sizeof header);
  for (const std::uint32_t i : chosen) {
    const FieldStar& s = all[i];
    const PairIndex::IndexStar star{{static_cast<float>(s.direction_N.x()), static_cast<float>(s.direction_N.y()),
                                     static_cast<float>(s.direction_N.z())},
                                    s.v_mag,
                                    s.catalogue_index};
    put(&star, sizeof star);
  }
  put(first.data(), first.size() * 4);
  for (const Entry& e : entries) put(&e.pair, sizeof e.pair);
  return bytes;
}

Result<PairIndex> PairIndex::open(std::span<const std::byte> bytes) {
  constexpr const char* kWhere = "pair index";
  if (bytes.size() < sizeof(Header))
    return fail(ErrorCode::corrupt_data, "{0} bytes are too few for the header of {1}",
                {static_cast<double>(bytes.size()), sizeof(Header)}, kWhere);
  if (reinterpret_cast<std::uintptr_t>(bytes.data()) % alignof(double) != 0)
    return fail(ErrorCode::corrupt_data, "the block is not aligned to 8 bytes", {}, kWhere);
  Header header;
  std::memcpy(&header, bytes.data(), sizeof header);
  if (std::memcmp(header.magic, kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::corrupt_data, "it does not begin with ANAVPAIR", {}, kWhere);
  if (header.version != kVersion)
    return fail(ErrorCode::unsupported, "version {0}; version {1} is read here",
                {static_cast<double>(header.version), static_cast<double>(kVersion)}, kWhere);
  const std::uint64_t expected = sizeof(Header) + std::uint64_t{header.stars} * sizeof(IndexStar) +
                                 (std::uint64_t{header.slots} + 1) * 4 + std::uint64_t{header.pairs} * sizeof(Pair);
  if (header.stars > kMaxStars || header.slots == 0 || expected != bytes.size())
    return fail(ErrorCode::corrupt_data, "its counts ask for {0} bytes, but there are {1}",
                {static_cast<double>(expected), static_cast<double>(bytes.size())}, kWhere);
  if (!(header.max_angle_rad > 0.0 && header.max_angle_rad < kPi && header.radius_rad >= 0.0))
    return fail(ErrorCode::corrupt_data, "a longest angle of {0} rad", {header.max_angle_rad}, kWhere);
  PairIndex index;
  const std::byte* at = bytes.data() + sizeof(Header);
  index.stars_ = {reinterpret_cast<const IndexStar*>(at), header.stars};
  at += index.stars_.size_bytes();
  index.first_ = {reinterpret_cast<const std::uint32_t*>(at), header.slots + std::size_t{1}};
  at += index.first_.size_bytes();
  index.pairs_ = {reinterpret_cast<const Pair*>(at), header.pairs};
  std::uint32_t last = 0;
  for (const std::uint32_t first : index.first_) {
    if (first < last || first > header.pairs)
      return fail(ErrorCode::corrupt_data, "its slots are out of order", {}, kWhere);
    last = first;
  }
  for (const Pair& pair : index.pairs_) {
    if (pair.a >= header.stars || pair.b >= header.stars)
      return fail(ErrorCode::corrupt_data, "a pair names star {0} of {1}",
                  {static_cast<double>(std::max(pair.a, pair.b)), static_cast<double>(header.stars)}, kWhere);
  }
  index.max_angle_rad_ = header.max_angle_rad;
  index.radius_rad_ = header.radius_rad;
  index.neighbours_ = static_cast<int>(header.neighbours);
  index.cos_first_ = std::cos(header.max_angle_rad);
  index.slots_per_cos_ = header.slots / (1.0 - index.cos_first_);
  return index;
}

std::span<const PairIndex::Pair> PairIndex::pairs(double cos_min, double cos_max) const {
  const double slots = static_cast<double>(first_.size() - 1);
  const double lo = std::floor((cos_min - cos_first_) * slots_per_cos_),
               hi = std::floor((cos_max - cos_first_) * slots_per_cos_);
  if (!(hi >= 0.0) || !(lo < slots)) return {};
  const std::size_t from = first_[static_cast<std::size_t>(std::max(lo, 0.0))];
  const std::size_t to = first_[static_cast<std::size_t>(std::min(hi, slots - 1.0)) + 1];
  return pairs_.subspan(from, to - from);
}

}  // namespace astronav::vision
