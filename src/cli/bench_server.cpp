// SPDX-License-Identifier: Apache-2.0
// Figures of the SkySimulator server: what it costs beside the rendering, over loopback.
#include <algorithm>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "cli/bench.h"
#include "cli/bench_timing.h"
#include "cli/inputs.h"
#include "foundation/math/rotation.h"
#include "models/camera_file/camera_file.h"
#include "models/ephemeris/bodies.h"
#include "simulator/render/renderer.h"
#include "simulator/server/client.h"
#include "simulator/server/server.h"
#include "simulator/sky/sky.h"

namespace astronav::cli::bench {
namespace {

constexpr double kRoundS = 0.5;
constexpr int kRounds = 5;
constexpr int kAhead = 6;  // requests under way
constexpr double kMaxV = 8.0;

// A server with one worker, and the sky that it has.
class Loopback {
 public:
  static Result<std::unique_ptr<Loopback>> create() {
    auto out = std::make_unique<Loopback>();
    auto kernels = open_kernels();
    if (!kernels) return forward(kernels);
    out->kernels = *kernels;
    auto catalogue = open_catalogue("");
    if (!catalogue) return forward(catalogue);
    out->catalogue = std::move(*catalogue);
    auto camera = read_camera("extrema-20deg");
    if (!camera) return forward(camera);
    out->camera = std::make_shared<const Camera>(std::move(*camera));
    server::Registry registry;
    registry.cameras["extrema-20deg"] = out->camera;
    registry.parse_observer = [kernels = *kernels](std::string_view text) { return parse_observer(text, kernels); };
    server::ServerSettings settings;
    settings.workers = 1;
    auto made = server::Server::create(settings, std::move(registry), out->kernels->ephemeris, out->catalogue.stars);
    if (!made) return forward(made);
    out->server = std::move(*made);
    out->thread = std::thread([s = out->server.get()] { s->run(); });
    auto client = server::Client::connect("127.0.0.1", out->server->port());
    if (!client) return forward(client);
    out->client = std::make_unique<server::Client>(std::move(*client));
    server::SceneRequest settings_request;
    settings_request.epoch = out->epoch;
    settings_request.observer = "earth";
    settings_request.camera = "extrema-20deg";
    settings_request.max_v_mag = kMaxV;
    if (auto set = out->client->set(settings_request); !set) return forward(set);
    return out;
  }
  ~Loopback() {
    client.reset();
    if (thread.joinable()) {
      server->stop();
      thread.join();
    }
  }

  Pointing pointing() {
    return {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)};
  }

  std::shared_ptr<const Kernels> kernels;
  OpenCatalogue catalogue;
  std::shared_ptr<const Camera> camera;
  std::unique_ptr<server::Server> server;
  std::thread thread;
  std::unique_ptr<server::Client> client;
  Epoch epoch = Epoch::tdb_seconds(8.6e8);
  RandomStream random{{.seed = 1, .purpose = "bench server"}};
};

// What the server's worker does for a frame, without a server.
class Direct {
 public:
  explicit Direct(const Loopback& loopback)
      : loopback_(loopback),
        sky_(loopback.kernels->ephemeris, loopback.catalogue.stars),
        band_(*loopback.camera),
        renderer_(*loopback.camera, 1) {}

  Result<void> shoot(const Pointing& pointing) {
    const Mat3 R_CN = R_CN_from_pointing(pointing);
    const Ephemeris& ephemeris = loopback_.kernels->ephemeris;
    const auto state = ephemeris.state(body::earth, body::solar_system_barycenter, loopback_.epoch);
    if (!state) return forward(state);
    const Intrinsics& k = loopback_.camera->intrinsics;
    const auto seen = sky_.look(loopback_.epoch, *state, R_CN.row(2).transpose(),
                                k.half_diagonal_rad() + 40.0 * k.plate_scale_rad_px(), band_, {.max_v_mag = kMaxV});
    if (!seen) return forward(seen);
    render::Exposure exposure{.duration_s = loopback_.camera->exposure_s};
    exposure.sun_C_m = R_CN * sky_.sun_N_m(loopback_.epoch, *state);
    const auto sources = render::place_sources(*seen, *loopback_.camera, R_CN, exposure);
    renderer_.frame(sources, exposure, {.image = ++images_, .purpose = "frame"}, frame_);
    return {};
  }

 private:
  const Loopback& loopback_;
  sky::Sky sky_;
  BandPhotometry band_;
  render::Renderer renderer_;
  ImageU16 frame_;
  std::uint64_t images_ = 0;
};

}  // namespace

Result<Figure> server_share_of_renderer(Bench& bench) {
  auto loopback = Loopback::create();
  if (!loopback) return forward(loopback);
  Loopback& l = **loopback;
  Direct direct(l);
  server::Frame frame;
  std::uint64_t images = 0;
  const auto ask = [&]() -> Result<void> {
    server::SceneRequest scene;
    scene.pointing = l.pointing();
    scene.image = ++images;
    const auto sent = l.client->send(scene);
    return sent ? Result<void>() : Result<void>(forward(sent));
  };
  std::vector<double> alone, served, alone_cpu, served_cpu;
  for (int round = -1; round < kRounds; ++round) {  // the first warms up
    double begin = seconds_now(), processor = processor_seconds_now();
    int frames = 0;
    for (; seconds_now() - begin < kRoundS; ++frames) {
      if (auto ok = direct.shoot(l.pointing()); !ok) return forward(ok);
    }
    const double alone_fps = frames / (seconds_now() - begin);
    const double alone_ms = 1e3 * (processor_seconds_now() - processor) / frames;
    for (int i = 0; i < kAhead; ++i) {
      if (auto ok = ask(); !ok) return forward(ok);
    }
    begin = seconds_now();
    processor = processor_seconds_now();
    for (frames = 0; seconds_now() - begin < kRoundS; ++frames) {
      if (auto ok = l.client->receive(frame); !ok) return forward(ok);
      if (auto ok = ask(); !ok) return forward(ok);
    }
    const double served_fps = frames / (seconds_now() - begin);
    const double served_ms = 1e3 * (processor_seconds_now() - processor) / frames;
    for (int i = 0; i < kAhead; ++i) {
      if (auto ok = l.client->receive(frame); !ok) return forward(ok);
    }
    if (round >= 0) {
      alone.push_back(alone_fps);
      served.push_back(served_fps);
      alone_cpu.push_back(alone_ms);
      served_cpu.push_back(served_ms);
    }
    bench.progress((round + 2.0) / (kRounds + 1.0), "");
  }
  return Figure{
      median(served) / median(alone), "",
      fmt::format("one worker, raw 1024 x 1024 over loopback, {} requests ahead: {:.0f} frames/s of the {:.0f} "
                  "that the renderer makes on one core, medians of {} rounds by turns; processor time a frame {:.2f} "
                  "ms, served {:.2f} (server and client)",
                  kAhead, median(served), median(alone), kRounds, median(alone_cpu), median(served_cpu))};
}

Result<Figure> server_latency_ms(Bench& bench) {
  auto loopback = Loopback::create();
  if (!loopback) return forward(loopback);
  Loopback& l = **loopback;
  Direct direct(l);
  constexpr int kSamples = 1000;
  std::vector<double> whole, alone, ping;
  server::Frame frame;
  for (int i = -20; i < kSamples; ++i) {
    const Pointing pointing = l.pointing();
    double begin = seconds_now();
    if (auto ok = direct.shoot(pointing); !ok) return forward(ok);
    const double alone_s = seconds_now() - begin;
    server::SceneRequest scene;
    scene.pointing = pointing;
    begin = seconds_now();
    if (auto sent = l.client->send(scene); !sent) return forward(sent);
    if (auto received = l.client->receive(frame); !received) return forward(received);
    const double whole_s = seconds_now() - begin;
    const auto pong = l.client->ping();
    if (!pong) return forward(pong);
    if (i < 0) continue;
    whole.push_back(whole_s);
    alone.push_back(alone_s);
    ping.push_back(*pong);
    if (i % 100 == 0) bench.progress(static_cast<double>(i) / kSamples, "");
  }
  return Figure{
      1e3 * median(whole), "ms",
      fmt::format("one request at a time, from asking to the last byte of a raw 1024 x 1024 frame: median of {}, "
                  "99 % within {:.3g} ms; the rendering alone {:.3g} (99 %: {:.3g}); a ping {:.3g}",
                  kSamples, 1e3 * quantile(whole, 0.99), 1e3 * median(alone), 1e3 * quantile(alone, 0.99),
                  1e3 * median(ping))};
}

}  // namespace astronav::cli::bench
