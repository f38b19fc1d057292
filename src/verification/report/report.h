// SPDX-License-Identifier: Apache-2.0
// Report: one HTML file that opens from disk with no network: charts, trajectory, frames, figures and the scenario of a
// mission, or the pooled figures of a campaign. At most about 6 MB: frames beyond that are left out.
#pragma once

#include <string>

#include "foundation/base/error.h"
#include "verification/campaign/campaign.h"
#include "verification/loop/records.h"
#include "verification/loop/summary.h"

namespace astronav::report {

std::string mission_html(const loop::Records& records, const loop::Summary& summary);
std::string campaign_html(const campaign::Outcome& outcome, const campaign::Statistics& statistics);

// A frame as people look at it: the background dark, faint stars visible, bright ones not washed out (asinh above the
// median, in units of the noise). 8 bits.
Image<std::uint8_t> brighten(ImageView<const std::uint16_t> frame);

}  // namespace astronav::report
