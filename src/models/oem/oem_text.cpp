// SPDX-License-Identifier: Apache-2.0
#include <iterator>

#include <fmt/format.h>

#include "foundation/base/check.h"
#include "models/oem/oem.h"

namespace astronav {
namespace {

std::string center_name(BodyId id) {
  std::string name(body_name(id));
  if (name.empty()) return fmt::format("{}", id.value);
  for (char& c : name) {
    if (c == '-') c = ' ';
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
  }
  return name;
}

}  // namespace

std::string to_text(const Oem& oem) {
  ASTRONAV_CHECK(!oem.states.empty());
  ASTRONAV_CHECK_OP(oem.states.size(), ==, oem.epochs.size());
  const auto iso = [&oem](Epoch e) { return e.iso(oem.scale, 9, false); };
  fmt::memory_buffer buffer;
  const auto out = std::back_inserter(buffer);
  fmt::format_to(out, "CCSDS_OEM_VERS = 3.0\n");
  for (const std::string& c : oem.comments) fmt::format_to(out, "COMMENT {}\n", c);
  fmt::format_to(out, "CREATION_DATE = {}\nORIGINATOR = {}\n\nMETA_START\n",
                 oem.creation_date.empty() ? oem.epochs.front().iso(TimeScale::utc, 0, false) : oem.creation_date,
                 oem.originator);
  fmt::format_to(out, "OBJECT_NAME = {}\nOBJECT_ID = {}\nCENTER_NAME = {}\nREF_FRAME = ICRF\nTIME_SYSTEM = {}\n",
                 oem.object_name, oem.object_id, center_name(oem.center), name(oem.scale));
  fmt::format_to(out, "START_TIME = {}\n", iso(oem.epochs.front()));
  if (oem.useable_begin) fmt::format_to(out, "USEABLE_START_TIME = {}\n", iso(*oem.useable_begin));
  if (oem.useable_end) fmt::format_to(out, "USEABLE_STOP_TIME = {}\n", iso(*oem.useable_end));
  fmt::format_to(out, "STOP_TIME = {}\nINTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7\nMETA_STOP\n\n",
                 iso(oem.epochs.back()));
  for (std::size_t i = 0; i < oem.states.size(); ++i) {
    const Vec3 p = oem.states[i].p_m * 1e-3;
    const Vec3 v = oem.states[i].v_m_s * 1e-3;
    fmt::format_to(out, "{} {:.9f} {:.9f} {:.9f} {:.12f} {:.12f} {:.12f}\n", iso(oem.epochs[i]), p.x(), p.y(), p.z(),
                   v.x(), v.y(), v.z());
  }
  if (!oem.covariances.empty()) {
    fmt::format_to(out, "\nCOVARIANCE_START\n");
    for (const OemCovariance& c : oem.covariances) {
      fmt::format_to(out, "EPOCH = {}\nCOV_REF_FRAME = ICRF\n", iso(c.epoch));
      for (int row = 0; row < 6; ++row) {
        for (int column = 0; column <= row; ++column) {
          fmt::format_to(out, "{}{:.16e}", column == 0 ? "" : " ", c.covariance(row, column) * 1e-6);
        }
        fmt::format_to(out, "\n");
      }
    }
    fmt::format_to(out, "COVARIANCE_STOP\n");
  }
  return fmt::to_string(buffer);
}

}  // namespace astronav
