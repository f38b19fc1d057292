// SPDX-License-Identifier: Apache-2.0
// What `astronav bench` measures: one function a figure, all on one core, all with the default mission's cameras, sky
// and filter. docs/benchmarks.md says what each figure is.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/base/progress.h"
#include "models/camera/camera.h"
#include "onboard/vision/vision.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::cli::bench {

struct Figure {
  double value = 0.0;
  std::string unit;
  std::string detail;  // spread, counts, and what is meant
};

// What came of many rendered frames of random pointings; measured once, for seven figures.
struct Survey {
  int frames = 0;
  int solved = 0;   // lost in space, and right
  int wrong = 0;    // lost in space, and wrong
  int tracked = 0;  // solved from the prior attitude
  std::vector<double> lost_in_space_ms, tracked_ms, centroid_ms;
  std::vector<Vec3> attitude_errors_arcsec;  // camera axes, of the right ones
  std::vector<double> centroid_errors_px;    // both axes, stars with S/N > 20
};

// What the figures share.
struct Bench {
  static Result<Bench> create();

  scenario::Scenario scenario;  // the default mission, seed 1
  std::unique_ptr<loop::World> world;
  Camera believed;
  Epoch epoch;       // halfway
  State observer_O;  // the spacecraft there
  std::optional<Survey> survey;
  ProgressSink progress;  // within one figure
};

// What the image processing holds in memory between frames.
struct OnboardEyes {
  static Result<std::unique_ptr<OnboardEyes>> create(const Bench& bench);

  vision::StarField field, neighbours;
  std::vector<std::byte> index_bytes;
  vision::PairIndex index;
  std::unique_ptr<vision::Vision> vision;
  // Heap in use by each, bytes.
  std::size_t field_size = 0, neighbours_size = 0, index_size = 0, vision_size = 0;
};

// bench_frames.cpp
Result<Figure> render_fps_1024(Bench& bench);
Result<Figure> render_fps_2048(Bench& bench);
Result<Figure> render_fps_1024_halo(Bench& bench);
Result<Figure> render_frame_ms_1024(Bench& bench);
Result<Figure> render_two_threads(Bench& bench);
Result<Figure> vision_ms_lost_in_space_1024(Bench& bench);
Result<Figure> vision_ms_tracked_1024(Bench& bench);
Result<Figure> attitude_cross_arcsec(Bench& bench);
Result<Figure> attitude_cross_scatter_arcsec(Bench& bench);
Result<Figure> attitude_roll_arcsec(Bench& bench);
Result<Figure> centroid_px(Bench& bench);
Result<Figure> solve_success_rate(Bench& bench);

// bench_flight.cpp
Result<Figure> filter_update_us(Bench& bench);
Result<Figure> propagate_10d_ms(Bench& bench);
Result<Figure> ephemeris_states_per_s(Bench& bench);
Result<Figure> cone_search_us(Bench& bench);
Result<Figure> mission_s(Bench& bench);
Result<Figure> onboard_memory_mb(Bench& bench);

// bench_server.cpp
Result<Figure> server_share_of_renderer(Bench& bench);
Result<Figure> server_latency_ms(Bench& bench);

}  // namespace astronav::cli::bench
