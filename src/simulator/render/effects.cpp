// SPDX-License-Identifier: Apache-2.0
#include <array>

#include "simulator/render/renderer.h"

namespace astronav::render {
namespace {

struct NamedEffect {
  std::string_view name;
  bool Effects::*field;
};
constexpr std::array kEffects = std::to_array<NamedEffect>({
    {"shot", &Effects::shot},
    {"dark", &Effects::dark},
    {"read", &Effects::read},
    {"photo_nonuniformity", &Effects::photo_nonuniformity},
    {"dark_nonuniformity", &Effects::dark_nonuniformity},
    {"hot_pixels", &Effects::hot_pixels},
    {"cosmic_rays", &Effects::cosmic_rays},
    {"full_well", &Effects::full_well},
    {"blooming", &Effects::blooming},
    {"quantisation", &Effects::quantisation},
    {"frame_transfer", &Effects::frame_transfer},
    {"vignetting", &Effects::vignetting},
    {"stray_light", &Effects::stray_light},
    {"background", &Effects::background},
    {"psf_aberrations", &Effects::psf_aberrations},
    {"motion", &Effects::motion},
    {"discs", &Effects::discs},
});
static_assert(sizeof(Effects) == kEffects.size(), "every switch has a name");

}  // namespace

Effects Effects::expected() {
  Effects e;
  e.shot = e.read = e.photo_nonuniformity = e.dark_nonuniformity = e.hot_pixels = e.cosmic_rays = false;
  return e;
}

std::span<const std::string_view> effect_names() {
  static const auto names = [] {
    std::array<std::string_view, kEffects.size()> all;
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = kEffects[i].name;
    return all;
  }();
  return names;
}

bool* effect(Effects& effects, std::string_view name) {
  for (const NamedEffect& e : kEffects) {
    if (e.name == name) return &(effects.*e.field);
  }
  return nullptr;
}

}  // namespace astronav::render
