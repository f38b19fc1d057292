// SPDX-License-Identifier: Apache-2.0
// The real server and the real client over loopback: what is answered.
#include "simulator/server/server.h"

#include <algorithm>
#include <thread>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "foundation/raster/raster.h"
#include "models/photometry/photometry.h"
#include "simulator/render/renderer.h"
#include "simulator/server/server_for_tests.h"
#include "simulator/server/studio.h"
#include "simulator/sky/sky.h"
#include "support/program.h"
#include "support/shared_data.h"

namespace astronav::server {
namespace {

using nlohmann::json;

const Epoch kEpoch = *Epoch::parse("2027-03-01T00:00:00 TDB");
const Pointing kOrion{84.0 * kDegree, 0.5 * kDegree, 30.0 * kDegree};

SceneRequest orion() {
  SceneRequest scene;
  scene.epoch = kEpoch;
  scene.observer = "mars";
  scene.pointing = kOrion;
  scene.camera = "extrema-20deg";
  scene.max_v_mag = 7.0;
  return scene;
}

// One request as it is, and its answer.
json ask(Client& client, std::uint16_t type, const std::string& text, std::uint16_t* answer_type = nullptr) {
  EXPECT_TRUE(client.send_raw(type, text));
  const auto answer = client.receive_raw();
  if (!answer) {
    ADD_FAILURE() << describe(answer.error()) << " after " << text;
    return {};
  }
  if (answer_type != nullptr) *answer_type = answer->type;
  return json::parse(answer->json);
}

TEST(Server, TellsItsNameLimitsCamerasAndObservers) {
  const RunningServer server;
  const Client client = server.client();
  EXPECT_TRUE(client.welcome().server.starts_with("astronav "));
  EXPECT_EQ(client.welcome().limits.json_bytes, Limits().json_bytes);
  EXPECT_EQ(client.welcome().limits.image_pixels, Limits().image_pixels);
  EXPECT_EQ(client.welcome().cameras, (std::vector<std::string>{"extrema-20deg", "navcam", "small"}));
  EXPECT_EQ(client.welcome().observers, std::vector<std::string>{"craft"});
}

TEST(Server, PicturesAreTheRenderersOwn) {
  const Camera camera = *read_camera("extrema-20deg");
  const ShippedSky& shipped = ShippedSky::get();
  const State observer_O = *shipped.ephemeris.state(body::mars_barycenter, body::solar_system_barycenter, kEpoch);
  const Mat3 R_CN = R_CN_from_pointing(kOrion);
  const auto seen = sky::Sky(shipped.ephemeris, shipped.stars)
                        .look(kEpoch, observer_O, R_CN.row(2).transpose(), camera.intrinsics.half_diagonal_rad() + 0.1,
                              BandPhotometry(camera), {.max_v_mag = 7.0});
  ASSERT_TRUE(seen);
  render::Exposure exposure{.duration_s = 0.3, .rate_C_rad_s = Vec3(1e-4, 2e-4, 0.0)};
  exposure.sun_C_m = R_CN * light_time(shipped.ephemeris, body::sun, observer_O, kEpoch)->relative.p_m;
  render::Effects effects;
  effects.dark = false;
  const auto sources = render::place_sources(*seen, camera, R_CN, exposure, 20.0, effects);
  const render::Renderer renderer(camera, 9);
  ImageU16 dn;
  renderer.frame(sources, exposure, {.seed = 5, .sample = 6, .image = 7, .purpose = ""}, dn, effects);
  ImageF electrons;
  renderer.electrons(sources, exposure, electrons, effects);

  const RunningServer server;
  Client client = server.client();
  SceneRequest scene = orion();
  scene.exposure_s = 0.3;
  scene.rate_C_rad_s = exposure.rate_C_rad_s;
  scene.effects = {{"dark", false}};
  scene.seed = 5;
  scene.sample = 6;
  scene.image = 7;
  scene.detector_seed = 9;
  const auto frame = client.render(scene);
  ASSERT_TRUE(frame) << describe(frame.error());
  EXPECT_EQ(frame->epoch, kEpoch);
  EXPECT_DOUBLE_EQ(frame->exposure_s, 0.3);
  EXPECT_LT((to_matrix(frame->q_NC).transpose() - R_CN).norm(), 1e-12);
  ASSERT_EQ(frame->dn.width(), 1024);
  EXPECT_TRUE(std::ranges::equal(frame->dn.pixels(), dn.pixels()));

  scene.format = PixelFormat::electrons;
  const auto expected = client.render(scene);
  ASSERT_TRUE(expected) << describe(expected.error());
  EXPECT_TRUE(std::ranges::equal(expected->electrons.pixels(), electrons.pixels()));

  scene.format = PixelFormat::png;
  const auto png = client.render(scene);
  ASSERT_TRUE(png) << describe(png.error());
  const testing::ScratchFolder folder;
  testing::write_text(folder.path() / "frame.png", png->png);
  const auto picture = read_picture(folder.path() / "frame.png");
  ASSERT_TRUE(picture);
  EXPECT_TRUE(std::ranges::equal(picture->pixels.pixels(), dn.pixels(),
                                 [](float a, std::uint16_t b) { return a == static_cast<float>(b); }));

  // Without a picture: the truth alone.
  scene.format = PixelFormat::none;
  scene.truth = true;
  const auto truth = client.render(scene);
  ASSERT_TRUE(truth) << describe(truth.error());
  std::vector<render::RenderedSource> inside;
  for (const auto& s : sources) {
    if (s.pixel.u >= -0.5 && s.pixel.v >= -0.5 && s.pixel.u < 1023.5 && s.pixel.v < 1023.5) inside.push_back(s);
  }
  ASSERT_EQ(truth->truth.size(), inside.size());
  for (std::size_t i = 0; i < inside.size(); ++i) {
    EXPECT_EQ(truth->truth[i].id, inside[i].source.id);
    EXPECT_NEAR(truth->truth[i].pixel.u, inside[i].pixel.u, 1e-6);
    EXPECT_NEAR(truth->truth[i].pixel.v, inside[i].pixel.v, 1e-6);
    EXPECT_NEAR(truth->truth[i].electrons, inside[i].electrons, 1e-9 * inside[i].electrons);
  }
}

TEST(Server, RemembersSettingsAndForgetsWhatOneRequestChanged) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest settings = orion();
  settings.camera = "small";
  ASSERT_TRUE(client.set(settings));
  const auto plain = client.render({});
  ASSERT_TRUE(plain) << describe(plain.error());
  EXPECT_EQ(plain->width_px, 64);
  EXPECT_EQ(plain->height_px, 48);
  EXPECT_DOUBLE_EQ(plain->exposure_s, 0.1);
  SceneRequest longer;
  longer.exposure_s = 0.7;
  EXPECT_DOUBLE_EQ(client.render(longer)->exposure_s, 0.7);
  EXPECT_DOUBLE_EQ(client.render({})->exposure_s, 0.1);
  // A request that fails changes nothing, however far it was read.
  std::uint16_t type = 0;
  ask(client, 2, R"({"id":1,"exposure_ms":5,"max_v_mag":"faint"})", &type);
  EXPECT_EQ(type, 199);
  EXPECT_DOUBLE_EQ(client.render({})->exposure_s, 0.1);
  const json said = ask(client, 2, R"({"id":77,"exposure_ms":250,"camera":"navcam"})", &type);
  EXPECT_EQ(type, 102);
  EXPECT_EQ(said["id"], 77);
  EXPECT_EQ(said["camera"], "navcam");
  EXPECT_EQ(said["exposure_ms"], 250.0);
  EXPECT_EQ(said["observer"], "mars");
}

TEST(Server, CameraOverTheWire) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest scene = orion();
  scene.camera.clear();
  scene.camera_toml = kSmallCamera;
  const auto sent = client.render(scene);
  ASSERT_TRUE(sent) << describe(sent.error());
  scene.camera_toml.clear();
  scene.camera = "small";
  const auto named = client.render(scene);
  ASSERT_TRUE(named);
  EXPECT_TRUE(std::ranges::equal(sent->dn.pixels(), named->dn.pixels()));
}

TEST(Server, TheAirLiftsWhatIsSeenFromTheGround) {
  const RunningServer server;
  Client client = server.client();
  const Epoch epoch = kEpoch;
  const Vec3 zenith = ground_zenith({50.0 * kDegree, 10.0 * kDegree, 0.0}, epoch);
  // 15 degrees above the horizon.
  const Vec3 low = std::cos(75.0 * kDegree) * zenith + std::sin(75.0 * kDegree) * zenith.unitOrthogonal();
  const RaDec at = radec_from_direction(low);
  SceneRequest scene;
  scene.epoch = epoch;
  scene.observer = "ground:50,10,0";
  scene.pointing = Pointing{at.ra_rad, at.dec_rad, 0.0};
  scene.format = PixelFormat::none;
  scene.truth = true;
  scene.max_v_mag = 8.0;
  const auto bare = client.render(scene);
  ASSERT_TRUE(bare) << describe(bare.error());
  scene.refraction = true;
  const auto lifted = client.render(scene);
  ASSERT_TRUE(lifted) << describe(lifted.error());
  const double px = read_camera("extrema-20deg")->intrinsics.plate_scale_rad_px();
  int compared = 0;
  for (const TrueSource& star : lifted->truth) {
    const auto same = std::ranges::find(bare->truth, star.id, &TrueSource::id);
    if (same == bare->truth.end() || std::hypot(star.pixel.u - 511.5, star.pixel.v - 511.5) > 100.0) continue;
    const double moved = (star.pixel.vec() - same->pixel.vec()).norm() * px / kArcsecond;
    // 58.3" tan Z - 0.067" tan^3 Z, times 1010/1010 hPa, is 214" at 75 degrees; within 2 degrees of it 185" to 250".
    EXPECT_NEAR(moved, 217.0, 35.0);
    ++compared;
  }
  EXPECT_GT(compared, 2);
}

TEST(Server, BodiesOfItsKernelsAreDrawnByTheirMagnitude) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/2000001.bsp");
  const auto ceres = MappedFile::open(path);
  ASSERT_TRUE(ceres);
  const ShippedSky& shipped = ShippedSky::get();
  const std::vector<std::span<const std::byte>> kernels{shipped.kernel.bytes(), ceres->bytes()};
  const auto ephemeris = Ephemeris::open(kernels);
  ASSERT_TRUE(ephemeris);
  const Studio studio(*ephemeris, shipped.stars, {});
  const Registry registry = registry_for_tests();
  const auto seen = [&](const char* bodies) {
    Scene scene = first_settings(registry);
    const std::string text =
        R"({"epoch":"2027-03-01","attitude":{"body":"ceres"},"format":"none","bodies":)" + std::string(bodies) + "}";
    const auto read = read_scene(json::parse(text), {}, registry, Limits{}, scene);
    EXPECT_TRUE(read) << describe(read.error());
    Shot shot;
    const auto taken = studio.take(scene, shot);
    EXPECT_TRUE(taken) << describe(taken.error());
    std::vector<render::RenderedSource> bodies_seen;
    for (const auto& s : shot.sources) {
      if (s.source.kind == sky::SourceKind::small_body) bodies_seen.push_back(s);
    }
    return bodies_seen;
  };
  const auto known = seen("[]");
  const auto ours = seen(R"([{"id":2000001,"h":0.34,"g":0.12,"radius_km":4697}])");
  ASSERT_EQ(known.size(), 1u);
  ASSERT_EQ(ours.size(), 1u);
  // H 3.34 and G 0.12 are what is known of it; three magnitudes less, and ten times as large.
  EXPECT_NEAR(ours[0].source.v_mag, known[0].source.v_mag - 3.0, 0.1);
  EXPECT_NEAR(ours[0].source.angular_radius_rad / known[0].source.angular_radius_rad, 10.0, 0.1);
  EXPECT_NEAR(ours[0].electrons / known[0].electrons, std::pow(10.0, 1.2), 1.5);
  EXPECT_NEAR(ours[0].pixel.u, 511.5, 0.1);
}

TEST(Server, AnswersComeInTheOrderOfTheRequests) {
  const RunningServer server;
  Client client = server.client();
  ASSERT_TRUE(client.set(orion()));
  std::vector<std::uint64_t> ids;
  for (int i = 0; i < 24; ++i) {
    SceneRequest scene;
    // Large and small by turns: with several workers the small ones are done first.
    scene.camera = i % 3 == 0 ? "extrema-20deg" : "small";
    scene.image = static_cast<std::uint64_t>(i);
    ids.push_back(*client.send(scene));
  }
  Frame frame;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    ASSERT_TRUE(client.receive(frame));
    EXPECT_EQ(frame.id, ids[i]);
    EXPECT_EQ(frame.width_px, i % 3 == 0 ? 1024 : 64);
  }
}

TEST(Server, TrajectoryKeepsABodyInTheMiddle) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest scene;
  scene.observer = "craft";
  scene.body = "mars";
  scene.body_roll_rad = 0.3;
  scene.camera = "small";
  scene.truth = true;
  const Epoch stop = kEpoch + Duration::days(9.0);
  const auto id = client.send_trajectory(scene, kEpoch, stop, 86400.0);
  ASSERT_TRUE(id);
  Frame frame;
  ImageU16 first;
  for (int i = 0; i < 10; ++i) {
    ASSERT_TRUE(client.receive(frame)) << i;
    EXPECT_EQ(frame.id, *id);
    EXPECT_EQ(frame.index, static_cast<std::uint64_t>(i));
    EXPECT_EQ(frame.epoch, kEpoch + Duration::days(i));
    const auto mars = std::ranges::find_if(frame.truth, [](const TrueSource& s) { return s.name.starts_with("mars"); });
    ASSERT_NE(mars, frame.truth.end()) << i;
    // Its centre of light lies less than its radius from its centre: far below a pixel of 270 arcsec.
    EXPECT_NEAR(mars->pixel.u, 31.5, 0.05);
    EXPECT_NEAR(mars->pixel.v, 23.5, 0.05);
    if (i == 0) first = frame.dn;
  }
  EXPECT_FALSE(std::ranges::equal(first.pixels(), frame.dn.pixels()));
  ASSERT_TRUE(client.receive(frame));
  EXPECT_TRUE(frame.end);
  EXPECT_EQ(frame.status, "done");
  EXPECT_EQ(frame.index, 10u);
  // The fourth frame by itself: its noise is that of image 3.
  scene.epoch = kEpoch + Duration::days(9.0);
  scene.image = 9;
  const auto alone = client.render(scene);
  ASSERT_TRUE(alone);
  EXPECT_EQ(alone->json.find("\"index\""), std::string::npos);
}

TEST(Server, TrajectoryOfListedScenes) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest common = orion();
  common.camera = "small";
  std::vector<SceneRequest> scenes(5);
  for (int i = 0; i < 5; ++i) scenes[i].pointing = Pointing{kOrion.ra_rad, kOrion.dec_rad, 0.1 * i};
  scenes[3].image = 0;
  ASSERT_TRUE(client.send_trajectory(common, scenes));
  std::vector<Frame> frames(6);
  for (Frame& frame : frames) ASSERT_TRUE(client.receive(frame));
  EXPECT_TRUE(frames[5].end);
  for (std::uint64_t i = 0; i < 5; ++i) {
    common.pointing = scenes[i].pointing;
    common.image = i == 3 ? 0 : i;
    const auto alone = client.render(common);
    ASSERT_TRUE(alone);
    EXPECT_TRUE(std::ranges::equal(alone->dn.pixels(), frames[i].dn.pixels())) << i;
  }
}

TEST(Server, CancelEndsATrajectory) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest scene = orion();
  const auto id = client.send_trajectory(scene, kEpoch, kEpoch + Duration::seconds(99'999.0), 1.0);
  ASSERT_TRUE(id);
  Frame frame;
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(client.receive(frame));
  ASSERT_TRUE(client.cancel(*id));
  int more = 0;
  do {
    ASSERT_TRUE(client.receive(frame));
    ++more;
  } while (!frame.end);
  EXPECT_EQ(frame.status, "cancelled");
  EXPECT_LT(more, 1000);  // what was on its way: bounded by the session's room
  // Too late: it is said, and the session goes on.
  std::uint16_t type = 0;
  EXPECT_TRUE(client.ping());  // passes over what became of the first cancel
  const json said = ask(client, 5, R"({"id":500,"request":)" + std::to_string(*id) + "}", &type);
  EXPECT_EQ(type, 199);
  EXPECT_EQ(said["code"], "not_found");
  EXPECT_TRUE(client.render(scene));
}

TEST(Server, TrajectoryThatFailsSaysWhereAndEnds) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest scene = orion();
  scene.camera = "small";
  scene.observer = "earth";
  // The kernel ends in 2050.
  ASSERT_TRUE(client.send_trajectory(scene, *Epoch::parse("2049-01-01"), *Epoch::parse("2060-01-01"), 86400.0 * 100));
  int frames = 0;
  while (true) {
    const auto answer = client.receive_raw();
    ASSERT_TRUE(answer);
    const json said = json::parse(answer->json);
    if (answer->type == 103) {
      EXPECT_EQ(said["index"], frames++);
    } else if (answer->type == 199) {
      EXPECT_EQ(said["code"], "out_of_range");
      EXPECT_EQ(said["index"], frames);
    } else {
      EXPECT_EQ(answer->type, 104);
      EXPECT_EQ(said["status"], "failed");
      EXPECT_EQ(said["frames"], frames);
      break;
    }
  }
  EXPECT_GT(frames, 2);
  EXPECT_TRUE(client.ping());
}

TEST(Server, BadRequestsAreAnsweredAndTheSessionGoesOn) {
  const RunningServer server;
  Client client = server.client();
  ASSERT_TRUE(client.set(orion()));
  struct Bad {
    std::uint16_t type;
    const char* json;
    const char* code;
    const char* says;
  };
  const std::vector<Bad> all{
      {3, "", "corrupt_data", "one object"},
      {3, "[]", "corrupt_data", "one object"},
      {3, "{\"id\":1", "corrupt_data", "one object"},
      {3, "{\"id\":1,\"camera\":\"\xff\"}", "corrupt_data", "UTF-8"},
      {3, "{}", "invalid_argument", "has an id"},
      {3, R"({"id":-1})", "invalid_argument", "has an id"},
      {3, R"({"id":1.5})", "invalid_argument", "has an id"},
      {3, R"({"id":18446744073709551615})", "invalid_argument", "has an id"},
      {3, R"({"id":1,"a":[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]})", "limit_exceeded", "nested"},
      {3, R"({"id":1,"exposure":4})", "invalid_argument", "did you mean \"exposure_ms\""},
      {3, R"({"id":1,"exposure_ms":0})", "out_of_range", "exposure_ms"},
      {3, R"({"id":1,"exposure_ms":"4"})", "invalid_argument", "a number"},
      {3, R"({"id":1,"epoch":"yesterday"})", "invalid_argument", "epoch"},
      {3, R"({"id":1,"epoch":4})", "invalid_argument", "a text"},
      {3, R"({"id":1,"epoch":"2270-01-01 TDB"})", "out_of_range", ""},
      {3, R"({"id":1,"camera":"navcamm"})", "not_found", "did you mean \"navcam\""},
      {3, R"({"id":1,"camera":"/etc/passwd"})", "not_found", ""},
      {3, R"({"id":1,"camera":"../scenarios/cameras/navcam"})", "not_found", ""},
      {3, R"({"id":1,"camera":"navcam","camera_toml":"x=1"})", "invalid_argument", "either"},
      {3, R"({"id":1,"camera_toml":"name = "})", "invalid_argument", "TOML"},
      {3, R"({"id":1,"camera_toml":"psf.kernel = '/etc/passwd'"})", "unsupported", "point-spread"},
      {3, R"({"id":1,"camera_toml":"[psf]\n\"k\\u0065rnel\" = '/etc/passwd'"})", "unsupported", "point-spread"},
      {3, "{\"id\":1,\"camera_toml\":\"x = 1 \u00b5\"}", "unsupported", "ASCII"},
      {3, R"({"id":1,"observer":"oem:/etc/passwd"})", "unsupported", "files are not read"},
      {3, R"({"id":1,"observer":" \tspk:-1@/etc/passwd"})", "unsupported", "files are not read"},
      {3, R"({"id":1,"observer":"nowhere"})", "not_found", ""},
      {3, R"({"id":1,"observer":{}})", "invalid_argument", "position_km"},
      {3, R"({"id":1,"observer":{"position_km":{"x":1,"y":2}}})", "invalid_argument", "{x, y, z}"},
      {3, R"({"id":1,"observer":{"position_km":{"x":1,"y":2,"z":1e13}}})", "out_of_range", ""},
      {3, R"({"id":1,"attitude":{"ra_deg":5}})", "invalid_argument", "attitude"},
      {3, R"({"id":1,"attitude":{"ra_deg":5,"dec_deg":91}})", "out_of_range", "dec_deg"},
      {3, R"({"id":1,"attitude":{"q_NC":{"w":1,"x":1,"y":0,"z":0}}})", "invalid_argument", "no rotation"},
      {3, R"({"id":1,"attitude":{"body":"vulcan"}})", "not_found", ""},
      {3, R"({"id":1,"attitude":{"body":-77}})", "invalid_argument", "a text"},
      {3, R"({"id":1,"rate_deg_s":[0,0,0]})", "invalid_argument", "rate_deg_s"},
      {3, R"({"id":1,"rate_deg_s":{"x":360,"y":0,"z":0}})", "limit_exceeded", "degrees in the exposure"},
      {3, R"({"id":1,"effects":{"shots":true}})", "invalid_argument", "did you mean \"shot\""},
      {3, R"({"id":1,"effects":{"shot":1}})", "invalid_argument", "true or false"},
      {3, R"({"id":1,"effects":"none"})", "invalid_argument", "expected"},
      {3, R"({"id":1,"refraction":1})", "invalid_argument", "true or false"},
      {3, R"({"id":1,"refraction":true})", "invalid_argument", "refraction: there is no air at 'mars'"},
      {3, R"({"id":1,"bodies":{}})", "invalid_argument", "a list"},
      {3, R"({"id":1,"bodies":[{"id":433}]})", "invalid_argument", "{id, h, g, radius_km}"},
      {3, R"({"id":1,"bodies":[{"id":"eros","h":10}]})", "invalid_argument", "NAIF number"},
      {3, R"({"id":1,"bodies":[{"id":4e10,"h":10}]})", "invalid_argument", "NAIF number"},
      {3, R"({"id":1,"bodies":[{"id":2000433,"h":99}]})", "out_of_range", "bodies.h"},
      {3, R"({"id":1,"bodies":[{"id":2000433,"h":9,"mass":1}]})", "invalid_argument", "{id, h, g, radius_km}"},
      {3, R"({"id":1,"bodies":[{"id":2000433,"h":9},{"id":2000433,"h":9}]})", "invalid_argument", "comes twice"},
      {3, R"({"id":1,"bodies":[{"id":499,"h":9}]})", "invalid_argument", "drawn as it is"},
      {3, R"({"id":1,"bodies":[{"id":2000433,"h":9}]})", "not_found", "bodies: no kernel holds"},
      {3, R"({"id":1,"seed":-5})", "invalid_argument", "whole number"},
      {3, R"({"id":1,"format":"jpeg"})", "invalid_argument", "\"png\""},
      {3, R"({"id":1,"truth":"yes"})", "invalid_argument", "true or false"},
      {4, R"({"id":1})", "invalid_argument", "either scenes or start"},
      {4, R"({"id":1,"scenes":[]})", "invalid_argument", "list of scenes"},
      {4, R"({"id":1,"scenes":[{"id":4}]})", "invalid_argument", "id"},
      {4, R"({"id":1,"scenes":[{}],"start":"2027-01-01"})", "invalid_argument", "either"},
      {4, R"({"id":1,"start":"2027-01-02","stop":"2027-01-01","step_s":1})", "invalid_argument", "before it begins"},
      {4, R"({"id":1,"start":"2027-01-01","stop":"2028-01-01","step_s":0})", "invalid_argument", "step_s"},
      {4, R"({"id":1,"start":"2027-01-01","stop":"2028-01-01","step_s":1})", "limit_exceeded", "at most 1000000"},
      {4, R"({"id":1,"start":"1720-01-01 TDB","stop":"2280-01-01 TDB","step_s":1e9})", "out_of_range", ""},
      {5, R"({"id":1})", "invalid_argument", "trajectory"},
      {5, R"({"id":1,"request":12})", "not_found", "12"},
      {7, R"({"id":1})", "unsupported", "stimulation"},
      {0, R"({"id":1})", "unsupported", "type 0"},
      {103, R"({"id":1})", "unsupported", "type 103"},
      {65535, R"({"id":1})", "unsupported", "type 65535"},
  };
  for (const Bad& bad : all) {
    std::uint16_t type = 0;
    const json said = ask(client, bad.type, bad.json, &type);
    ASSERT_EQ(type, 199) << bad.json;
    EXPECT_EQ(said.value("code", ""), bad.code) << bad.json << said;
    EXPECT_NE(said.value("message", "").find(bad.says), std::string::npos) << bad.json << said;
    const json request = json::parse(bad.json, nullptr, false);
    const bool has_id = std::string(bad.says) != "has an id" && std::string(bad.says) != "nested" &&
                        request.is_object() && request.contains("id");
    EXPECT_EQ(said["id"], has_id ? json(1) : json(nullptr)) << bad.json;
  }
  EXPECT_TRUE(client.render({}));
}

TEST(Server, LimitsOnCamerasImagesAndListsAreKept) {
  ServerSettings settings;
  settings.limits.camera_bytes = 1000;
  settings.limits.image_pixels = 64 * 48;
  settings.limits.listed_scenes = 3;
  settings.limits.trajectory_frames = 5;
  const RunningServer server(settings);
  Client client = server.client();
  EXPECT_EQ(client.welcome().limits.image_pixels, 64u * 48u);
  SceneRequest scene = orion();
  scene.camera.clear();
  scene.camera_toml = kSmallCamera;
  EXPECT_TRUE(client.render(scene));
  scene.camera_toml = std::string(kSmallCamera) + "# " + std::string(1000, '.');
  auto refused = client.render(scene);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::limit_exceeded);
  scene.camera_toml = kSmallCamera;
  scene.camera_toml.replace(scene.camera_toml.find("width_px = 64"), 13, "width_px = 65");
  refused = client.render(scene);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::limit_exceeded);
  scene.camera_toml = kSmallCamera;
  ASSERT_TRUE(client.send_trajectory(scene, std::vector<SceneRequest>(4)));
  Frame frame;
  EXPECT_EQ(client.receive(frame).error().code, ErrorCode::limit_exceeded);
  ASSERT_TRUE(client.send_trajectory(scene, kEpoch, kEpoch + Duration::seconds(5.0), 1.0));
  EXPECT_EQ(client.receive(frame).error().code, ErrorCode::limit_exceeded);
  ASSERT_TRUE(client.send_trajectory(scene, kEpoch, kEpoch + Duration::seconds(4.0), 1.0));
  for (int i = 0; i < 6; ++i) ASSERT_TRUE(client.receive(frame));
  EXPECT_TRUE(frame.end);
}

TEST(Server, TenClientsAtOnceGetWhatOneGets) {
  ServerSettings settings;
  settings.workers = 3;
  const RunningServer server(settings);
  constexpr int kClients = 10, kFrames = 12;
  const auto scene_of = [](int i) {
    SceneRequest scene = orion();
    scene.camera = i % 4 == 0 ? "extrema-20deg" : "small";
    scene.image = static_cast<std::uint64_t>(i);
    return scene;
  };
  std::vector<ImageU16> truth;
  {
    Client client = server.client();
    for (int i = 0; i < kFrames; ++i) truth.push_back(client.render(scene_of(i))->dn);
  }
  std::vector<std::thread> threads;
  std::array<int, kClients> right{};
  for (int c = 0; c < kClients; ++c) {
    threads.emplace_back([&, c] {
      Client client = server.client();
      for (int i = 0; i < kFrames; ++i) (void)client.send(scene_of((i + c) % kFrames));
      Frame frame;
      for (int i = 0; i < kFrames; ++i) {
        if (!client.receive(frame)) return;
        right[c] += std::ranges::equal(frame.dn.pixels(), truth[(i + c) % kFrames].pixels()) ? 1 : 0;
      }
    });
  }
  for (auto& thread : threads) thread.join();
  for (int c = 0; c < kClients; ++c) EXPECT_EQ(right[c], kFrames) << c;
}

}  // namespace
}  // namespace astronav::server
