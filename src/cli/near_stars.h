// SPDX-License-Identifier: Apache-2.0
// A list of stars by name, as Gaia gives them: CSV with the columns name, epoch_jyear, ra_deg, dec_deg, parallax_mas,
// pm_ra_cosdec_mas_yr, pm_dec_mas_yr and, where known, v_mag, b_v, v_i.
#pragma once

#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "models/photometry/photometry.h"
#include "models/stars/catalogue.h"

namespace astronav::cli {

struct ListedStar {
  std::string name;
  Star star;  // at J2000, by uniform motion in space; its radial velocity counts for nothing over decades
  double v_i = kUnknownColour;
};
// Errors name file and line.
Result<std::vector<ListedStar>> read_near_stars(const std::string& path);

}  // namespace astronav::cli
