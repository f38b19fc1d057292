// SPDX-License-Identifier: Apache-2.0
// A server on a port of its own, in a thread of its own, with the shipped ephemeris and stars.
#pragma once

#include <memory>
#include <string>
#include <thread>
#include <utility>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "models/camera_file/camera_file.h"
#include "models/ephemeris/bodies.h"
#include "simulator/server/client.h"
#include "simulator/server/server.h"

namespace astronav::server {

struct ShippedSky {
  MappedFile kernel, catalogue;
  Ephemeris ephemeris;
  StarCatalogue stars;

  static const ShippedSky& get() {
    static const ShippedSky sky = [] {
      ShippedSky s;
      s.kernel = *MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
      s.catalogue = *MappedFile::open(home_directory() / "data/hipparcos.stars");
      s.ephemeris = *Ephemeris::open(s.kernel.bytes());
      s.stars = *StarCatalogue::open(s.catalogue.bytes());
      return s;
    }();
    return sky;
  }
};

inline const char* const kSmallCamera = R"(name = "small"
exposure_ms = 100.0
[image]
width_px = 64
height_px = 48
[optics]
focal_length_mm = 10.0
pupil_diameter_mm = 10.0
transmission_wavelength_nm = [450.0, 900.0]
transmission = [0.7, 0.7]
[psf]
sigma_px = 0.8
[detector]
pixel_pitch_um = 13.0
quantum_efficiency_wavelength_nm = [450.0, 900.0]
quantum_efficiency = [0.7, 0.7]
read_noise_e = 10.0
dark_current_e_s = 12.0
full_well_e = 100000.0
gain_e_dn = 25.0
bias_dn = 64.0
bits = 12
background_e_s_px = 30.0
)";

// Three cameras, the bodies, and a craft that drifts along x, 1 au from the barycentre.
inline Registry registry_for_tests() {
  Registry registry;
  for (const char* name : {"extrema-20deg", "navcam"}) {
    registry.cameras[name] = std::make_shared<const Camera>(*read_camera(name));
  }
  registry.cameras["small"] = std::make_shared<const Camera>(*parse_camera(kSmallCamera, "small"));
  registry.observers["craft"] = [](Epoch epoch) -> Result<State> {
    State state;
    state.v_m_s = Vec3(10e3, 0.0, 0.0);
    state.p_m = Vec3(0.0, kAstronomicalUnit, 0.0) + state.v_m_s * epoch.tdb_seconds() * 1e-3;
    return state;
  };
  registry.parse_observer = [](std::string_view text) -> Result<Observer> {
    if (text == "ground:50,10,0") {
      return Observer([](Epoch epoch) -> Result<State> {
        auto state = ShippedSky::get().ephemeris.state(body::earth, body::solar_system_barycenter, epoch);
        if (!state) return state;
        const State site = ground_state({50.0 * kDegree, 10.0 * kDegree, 0.0}, epoch);
        return State{state->p_m + site.p_m, state->v_m_s + site.v_m_s};
      });
    }
    const auto body = parse_body(text);
    if (!body) return forward(body);
    const auto held = ShippedSky::get().ephemeris.resolve(*body);
    if (!held) return forward(held);
    return Observer([id = *held](Epoch epoch) {
      return ShippedSky::get().ephemeris.state(id, body::solar_system_barycenter, epoch);
    });
  };
  registry.parse_ground_site = [](std::string_view text) -> Result<std::optional<GroundSite>> {
    if (text != "ground:50,10,0") return std::optional<GroundSite>();
    return GroundSite{50.0 * kDegree, 10.0 * kDegree, 0.0};
  };
  return registry;
}

class RunningServer {
 public:
  explicit RunningServer(ServerSettings settings = {}) {
    auto made = Server::create(settings, registry_for_tests(), ShippedSky::get().ephemeris, ShippedSky::get().stars);
    if (!made) {
      ADD_FAILURE() << describe(made.error());
      return;
    }
    server_ = std::move(*made);
    port_ = server_->port();
    web_port_ = server_->web_port();
    thread_ = std::thread([this] { server_->run(); });
  }
  ~RunningServer() {
    if (thread_.joinable()) {
      server_->stop();
      thread_.join();
    }
  }
  Server& server() { return *server_; }
  std::uint16_t port() const { return port_; }
  std::uint16_t web_port() const { return web_port_; }
  void join() { thread_.join(); }

  Client client(const std::string& token = {}) const {
    auto client = Client::connect("127.0.0.1", port_, {.token = token, .timeout_s = 60.0});
    if (!client) {
      ADD_FAILURE() << describe(client.error());
      std::abort();
    }
    return std::move(*client);
  }

 private:
  std::unique_ptr<Server> server_;
  std::uint16_t port_ = 0, web_port_ = 0;
  std::thread thread_;
};

}  // namespace astronav::server
