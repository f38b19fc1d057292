// SPDX-License-Identifier: Apache-2.0
// Client of the SkySimulator: asks a server for pictures and waits for them. Blocking, for one thread.
//
//   auto client = Client::connect("127.0.0.1", 4242);
//   client->set({.observer = "earth", .camera = "extrema-20deg"});
//   auto frame = client->render({.epoch = epoch, .pointing = Pointing{...}});   // frame->dn holds the DN
//
// Several requests may be under way: send() them, then receive() the answers, which come in the same order.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/image/image.h"
#include "foundation/math/rotation.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/photometry/small_bodies.h"
#include "simulator/server/protocol.h"
#include "simulator/server/scene.h"

namespace astronav::server {

// What is to be seen; what is left out is as in the session's settings.
struct SceneRequest {
  std::optional<Epoch> epoch;
  std::string observer;  // as on the command line, or a name that the server told
  std::optional<State> observer_state_O;
  // At most one of the three: an attitude, a pointing, or a body to look at (with the roll).
  std::optional<Quaternion> q_NC;
  std::optional<Pointing> pointing;
  std::string body;
  double body_roll_rad = 0.0;
  std::optional<Vec3> rate_C_rad_s;
  std::string camera;
  std::string camera_toml;
  std::optional<double> exposure_s;
  bool expected = false;                              // no random draw, no fixed pattern; before `effects`
  std::vector<std::pair<std::string, bool>> effects;  // by name
  std::optional<double> max_v_mag;
  std::optional<bool> refraction;                // of an observer on the ground
  std::optional<std::vector<SmallBody>> bodies;  // by H and G
  std::optional<std::uint64_t> seed, sample, image, detector_seed;
  std::optional<PixelFormat> format;
  std::optional<bool> truth;
};

struct TrueSource {
  std::int64_t id = 0;
  std::string kind;  // "star", "planet", "small_body"
  std::string name;  // of bodies
  Pixel pixel;
  double electrons = 0.0;
  double v_mag = 0.0;
};

// A picture, or the end of a trajectory.
struct Frame {
  std::uint64_t id = 0;     // of the request
  std::uint64_t index = 0;  // in a trajectory
  bool end = false;         // of a trajectory: no picture; `index` is how many there were
  std::string status;       // of the end: "done", "cancelled", "failed"
  PixelFormat format = PixelFormat::dn;
  int width_px = 0;
  int height_px = 0;
  Epoch epoch;
  Epoch time_tag;  // the middle of the exposure by the camera's own clock
  double exposure_s = 0.0;
  Quaternion q_NC;
  ImageU16 dn;       // one of the three, by the format
  ImageF electrons;  //
  std::string png;   //
  std::vector<TrueSource> truth;
  std::string json;  // everything that was said of it
};

struct Welcome {
  std::string server;
  Limits limits;
  std::vector<std::string> cameras;
  std::vector<std::string> observers;
};

class Client {
 public:
  struct Settings {
    std::string token;
    std::string name = "astronav client";
    double timeout_s = 60.0;  // for anything to come or to go
  };
  static Result<Client> connect(const std::string& host, std::uint16_t port, const Settings& settings);
  static Result<Client> connect(const std::string& host, std::uint16_t port) { return connect(host, port, {}); }
  Client(Client&& other) noexcept;
  Client& operator=(Client&& other) noexcept;
  ~Client();

  const Welcome& welcome() const { return welcome_; }

  // Of the session from now on.
  Result<void> set(const SceneRequest& scene);
  Result<Frame> render(const SceneRequest& scene);
  // Time (s) until the server answered.
  Result<double> ping();

  // The id of the request, whose answers receive() gives.
  Result<std::uint64_t> send(const SceneRequest& scene);
  Result<std::uint64_t> send_trajectory(const SceneRequest& scene, Epoch start, Epoch stop, double step_s);
  Result<std::uint64_t> send_trajectory(const SceneRequest& common, const std::vector<SceneRequest>& scenes);
  // The trajectory ends soon; its end is still to be received. The cancel's own answer is passed over.
  Result<void> cancel(std::uint64_t request);
  // The next picture, or the end of a trajectory, into a frame whose buffers are used again. An error that the server
  // answers with is the error here: the session goes on, unless its code is io_failure.
  Result<void> receive(Frame& frame);

  // For tests and bridges to other protocols: a connection that has not been greeted, and messages as they are.
  static Result<Client> open(const std::string& host, std::uint16_t port, const Settings& settings);
  struct Raw {
    std::uint16_t type = 0;
    std::string json;
    std::vector<std::byte> binary;
  };
  Result<void> send_raw(std::uint16_t type, std::string_view json);
  Result<Raw> receive_raw();

 private:
  Client(int socket, const Settings& settings) : socket_(socket), settings_(settings) {}
  Result<void> write_all(std::string_view bytes);
  Result<void> read_all(std::byte* out, std::size_t n);
  Result<void> wait(short events);
  Result<Header> receive_head(std::string& json);
  Result<Header> receive_answer(std::string& json);
  Result<void> expect(MessageType type);
  Result<void> greet();

  int socket_ = -1;
  Settings settings_;
  Welcome welcome_;
  std::uint64_t next_id_ = 1;
  std::vector<std::uint64_t> cancels_;  // not answered yet
};

}  // namespace astronav::server
