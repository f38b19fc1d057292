// SPDX-License-Identifier: Apache-2.0
// A camera that looks after itself before the SkySimulator: it sees Jupiter in the corner of its eye, turns to it, and
// chooses the exposure so that the planet fills three quarters of the range, whatever it was at first.
//
//   follow_jupiter PORT
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/rotation.h"
#include "simulator/server/client.h"

namespace {

using namespace astronav;

constexpr double kWidth = 1024.0, kFocalPx = 2903.7;                            // of extrema-20deg
constexpr double kBiasDn = 64.0, kFullDn = 4064.0, kWantedDn = 0.75 * kFullDn;  // its full well, at 25 electrons a DN

struct Spot {
  Pixel centre;
  double peak_dn = 0.0;
};

// The brightest pixel, and the centre of the light around it.
Spot brightest(const ImageU16& image) {
  const auto pixels = image.pixels();
  const auto at = static_cast<int>(std::ranges::max_element(pixels) - pixels.begin());
  const int u0 = std::clamp(at % image.width(), 3, image.width() - 4);
  const int v0 = std::clamp(at / image.width(), 3, image.height() - 4);
  double sum = 0.0, u_sum = 0.0, v_sum = 0.0;
  for (int v = v0 - 3; v <= v0 + 3; ++v) {
    for (int u = u0 - 3; u <= u0 + 3; ++u) {
      const double light = std::max(0.0, image(u, v) - kBiasDn - 30.0);
      sum += light;
      u_sum += light * u;
      v_sum += light * v;
    }
  }
  return {{u_sum / sum, v_sum / sum}, static_cast<double>(pixels[static_cast<std::size_t>(at)])};
}

int complain(const Error& error) {
  std::fprintf(stderr, "follow_jupiter: %s\n", describe(error).c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: follow_jupiter PORT\n");
    return 2;
  }
  auto client = server::Client::connect("127.0.0.1", static_cast<std::uint16_t>(std::atoi(argv[1])));
  if (!client) return complain(client.error());
  std::printf("connected to %s\n", client->welcome().server.c_str());

  const auto epoch = Epoch::parse("2027-03-01T00:00:00 TDB");
  server::SceneRequest session;
  session.epoch = *epoch;
  session.observer = "mars";
  session.camera = "extrema-20deg";
  if (auto set = client->set(session); !set) return complain(set.error());

  // Where Jupiter is, more or less: looked at once without a picture, then 6 degrees beside it.
  server::SceneRequest look;
  look.body = "jupiter";
  look.format = server::PixelFormat::none;
  const auto there = client->render(look);
  if (!there) return complain(there.error());
  Mat3 R_CN = rotation_exp(Vec3(5.0, -3.5, 40.0) * kDegree) * to_matrix(there->q_NC).transpose();

  double exposure_s = 1.0;
  std::FILE* table = std::fopen("loop.csv", "w");
  if (table == nullptr) return 1;
  std::fprintf(table, "frame,u_px,v_px,peak_dn,exposure_ms\n");
  server::Frame frame;  // its buffers serve for every picture
  for (std::uint64_t i = 0; i < 30; ++i) {
    server::SceneRequest scene;
    scene.q_NC = to_quaternion(R_CN.transpose());
    scene.exposure_s = exposure_s;
    scene.image = i;
    if (auto sent = client->send(scene); !sent) return complain(sent.error());
    if (auto received = client->receive(frame); !received) return complain(received.error());
    const Spot spot = brightest(frame.dn);
    std::fprintf(table, "%d,%.3f,%.3f,%.0f,%.4f\n", static_cast<int>(i), spot.centre.u, spot.centre.v, spot.peak_dn,
                 1e3 * exposure_s);
    const double du = spot.centre.u - 0.5 * (kWidth - 1.0), dv = spot.centre.v - 0.5 * (kWidth - 1.0);
    if (std::hypot(du, dv) < 0.3 && std::abs(spot.peak_dn / kWantedDn - 1.0) < 0.1) {
      std::printf("Jupiter in the middle after %d frames: peak %.0f of %.0f DN at %.3f ms\n", static_cast<int>(i) + 1,
                  spot.peak_dn, kFullDn, 1e3 * exposure_s);
      std::fclose(table);
      return 0;
    }
    // A turn about +y moves the sky to -u, one about +x to +v. v_C = R_CN v_N turns the other way.
    R_CN = rotation_exp(Vec3(dv, -du, 0.0) / kFocalPx) * R_CN;
    const bool saturated = spot.peak_dn > 0.98 * kFullDn;
    exposure_s *= saturated ? 0.25 : (kWantedDn - kBiasDn) / (spot.peak_dn - kBiasDn);
  }
  std::fclose(table);
  std::fprintf(stderr, "follow_jupiter: the loop did not settle\n");
  return 1;
}
