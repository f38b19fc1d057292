// SPDX-License-Identifier: Apache-2.0
#include "models/camera_file/camera_file.h"
#include "verification/scenario/scenario.h"

namespace astronav::scenario {

Result<Camera> truth_camera(const Scenario& scenario) {
  const TruthCamera& truth = scenario.truth.camera;
  auto camera = read_camera(truth.file);
  if (!camera) return camera;
  Intrinsics& k = camera->intrinsics;
  k.fx_px *= 1.0 + truth.focal_error_relative;
  k.fy_px *= 1.0 + truth.focal_error_relative;
  k.cx_px += truth.center_offset_u_px;
  k.cy_px += truth.center_offset_v_px;
  k.distortion.k1 += truth.k1_error;
  PointSpread& psf = camera->psf;
  psf.sigma_px *= truth.psf_sigma_scale;
  psf.sigma_growth_px = truth.psf_sigma_growth_px;
  psf.halo_fraction = truth.psf_halo_fraction;
  psf.halo_sigma_px = truth.psf_halo_sigma_px;
  psf.halo_offset_u_px = truth.psf_halo_offset_u_px;
  psf.halo_offset_v_px = truth.psf_halo_offset_v_px;
  return camera;
}

Result<Camera> onboard_camera(const Scenario& scenario) {
  return read_camera(scenario.onboard.camera.file);
}

}  // namespace astronav::scenario
