// SPDX-License-Identifier: Apache-2.0
// Clients that break the rules, on a wire of their own: slow, silent, half open, lying, too many, too eager. Each meets
// its limit, and another client is served meanwhile. Nothing here fails because a machine is slow: an event is waited
// for as long as it takes, up to kPatienceS.
#include <array>
#include <atomic>
#include <chrono>
#include <cstring>
#include <fstream>
#include <thread>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "simulator/server/server_for_tests.h"

namespace astronav::server {
namespace {

using nlohmann::json;

constexpr int kPatienceS = 60;

class Wire {
 public:
  explicit Wire(std::uint16_t port, int receive_buffer = 0) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    if (receive_buffer > 0) setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  }
  ~Wire() { ::close(socket_); }
  Wire(const Wire&) = delete;
  Wire& operator=(const Wire&) = delete;

  bool send(std::string_view bytes) {
    return ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size());
  }
  bool say(MessageType type, std::string_view text) { return send(message_head(type, text)); }
  void hello() { say(MessageType::hello, R"({"id":0,"versions":[1]})"); }
  void end() { ::shutdown(socket_, SHUT_WR); }

  // Whether n bytes came before the connection ended.
  bool receive(void* out, std::size_t n) {
    auto* at = static_cast<char*>(out);
    while (n > 0) {
      pollfd one{socket_, POLLIN, 0};
      if (poll(&one, 1, kPatienceS * 1000) <= 0) {
        ADD_FAILURE() << "nothing came in " << kPatienceS << " s";
        return false;
      }
      const ssize_t got = ::recv(socket_, at, n, 0);
      if (got <= 0) return false;
      at += got;
      n -= static_cast<std::size_t>(got);
    }
    return true;
  }
  struct Answer {
    int type = 0;  // 0: the connection has ended
    json said;
    std::vector<char> binary;
  };
  Answer answer() {
    std::array<std::byte, kHeaderBytes> head;
    if (!receive(head.data(), head.size())) return {};
    const auto header = decode_header(head);
    EXPECT_TRUE(header);
    std::string text(header->json_bytes, '\0');
    Answer out{header->type, {}, std::vector<char>(header->binary_bytes)};
    if (!receive(text.data(), text.size()) || !receive(out.binary.data(), out.binary.size())) return {};
    out.said = json::parse(text);
    return out;
  }
  // Reads on until the server has closed; whether it has.
  bool ends() {
    char byte = 0;
    while (receive(&byte, 1)) {
    }
    return true;
  }

 private:
  int socket_;
};

// Asks for pictures without a pause for as long as it lives, and minds whether they come.
class Bystander {
 public:
  explicit Bystander(const RunningServer& server) : client_(server.client()), thread_([this] { run(); }) {}
  ~Bystander() {
    const int then = served_;
    while (ok_ && served_ < then + 3) std::this_thread::yield();
    done_ = true;
    thread_.join();
    EXPECT_TRUE(ok_) << "a client that keeps the rules was not served";
  }

 private:
  void run() {
    SceneRequest scene;
    scene.epoch = *Epoch::parse("2027-03-01");
    scene.body = "mars";
    scene.camera = "small";
    while (!done_ && ok_) {
      ok_ = client_.render(scene).has_value();
      ++served_;
    }
  }
  Client client_;
  std::atomic<bool> done_ = false, ok_ = true;
  std::atomic<int> served_ = 0;
  std::thread thread_;
};

const char* const kScene =
    R"({"id":1,"epoch":"2027-03-01","attitude":{"ra_deg":84,"dec_deg":0},"camera":"extrema-20deg"})";

ServerSettings with(void (*change)(Limits&)) {
  ServerSettings settings;
  change(settings.limits);
  return settings;
}

TEST(ServerLimits, BrokenMessagesAreAnsweredAndTheConnectionClosed) {
  const RunningServer server;
  const Bystander bystander(server);
  struct Broken {
    std::string bytes;
    const char* code;
  };
  const std::string hello = message_head(MessageType::hello, R"({"id":0,"versions":[1]})");
  const auto head = [](Header header) {
    std::string out(kHeaderBytes, '\0');
    encode(header, reinterpret_cast<std::byte*>(out.data()));
    return out;
  };
  const std::vector<Broken> all{
      {"GET / HTTP/1.1\r\n\r\n", "corrupt_data"},
      {hello + "ANAW............", "corrupt_data"},
      {hello + head({1, 3, Limits().json_bytes + 1, 0}), "limit_exceeded"},
      {hello + head({1, 3, 0xffffffffu, 0xffffffffu}), "limit_exceeded"},
      {hello + head({1, 7, 10, 1}), "limit_exceeded"},
      {hello + message_head(MessageType::ping, R"({"id":1})", 0, 2), "unsupported"},
      {hello + hello, "invalid_argument"},
      {message_head(MessageType::ping, R"({"id":1})"), "invalid_argument"},
      {message_head(MessageType::hello, R"({"id":1,"versions":[2,3]})"), "unsupported"},
      {message_head(MessageType::hello, R"({"id":1})"), "invalid_argument"},
      {message_head(MessageType::hello, "nonsense"), "corrupt_data"},
  };
  for (const Broken& broken : all) {
    Wire wire(server.port());
    ASSERT_TRUE(wire.send(broken.bytes + std::string(5000, '?')));  // what comes after is of no interest
    Wire::Answer answer = wire.answer();
    if (answer.type == 101) answer = wire.answer();
    EXPECT_EQ(answer.type, 199) << broken.bytes;
    EXPECT_EQ(answer.said.value("code", ""), broken.code) << broken.bytes;
    EXPECT_TRUE(wire.ends());
  }
}

TEST(ServerLimits, TokenIsAskedForAndCompared) {
  ServerSettings settings;
  settings.token = "correct horse";
  const RunningServer server(settings);
  EXPECT_TRUE(Client::connect("127.0.0.1", server.port(), {.token = "correct horse"}));
  for (const char* wrong : {"", "correct hors", "correct horse ", "Correct horse"}) {
    const auto client = Client::connect("127.0.0.1", server.port(), {.token = wrong});
    ASSERT_FALSE(client) << wrong;
    EXPECT_EQ(client.error().code, ErrorCode::invalid_argument);
    EXPECT_NE(describe(client.error()).find("token"), std::string::npos);
  }
}

TEST(ServerLimits, OtherAddressesDemandAToken) {
  ServerSettings settings;
  const auto create = [&] {
    return Server::create(settings, registry_for_tests(), ShippedSky::get().ephemeris, ShippedSky::get().stars);
  };
  for (const char* open : {"0.0.0.0", "::"}) {
    settings.address = open;
    settings.token.clear();
    const auto refused = create();
    ASSERT_FALSE(refused) << open;
    EXPECT_NE(describe(refused.error()).find("token"), std::string::npos);
  }
  settings.address = "0.0.0.0";
  settings.token = "x";
  EXPECT_TRUE(create());
  settings.address = "example.com";
  EXPECT_EQ(create().error().code, ErrorCode::invalid_argument);
  settings.address = "localhost";
  EXPECT_TRUE(create());
  settings.address = "203.0.113.7";  // documentation's: no machine has it
  EXPECT_EQ(create().error().code, ErrorCode::io_failure);
}

TEST(ServerLimits, OneClientTooManyIsToldSo) {
  const RunningServer server(with([](Limits& l) { l.sessions = 2; }));
  auto first = std::make_unique<Client>(server.client());
  Client second = server.client();
  {
    Wire third(server.port());
    third.hello();
    const Wire::Answer answer = third.answer();
    EXPECT_EQ(answer.said.value("code", ""), "limit_exceeded");
    EXPECT_TRUE(third.ends());
  }
  EXPECT_TRUE(second.ping());
  first.reset();
  // There is room again as soon as the server has noticed.
  Result<Client> again = Client::connect("127.0.0.1", server.port());
  for (int i = 0; i < 600 && !again; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    again = Client::connect("127.0.0.1", server.port());
  }
  EXPECT_TRUE(again);
}

TEST(ServerLimits, SilentClientsAreClosed) {
  const RunningServer server(with([](Limits& l) { l.hello_s = 0.3; }));
  const Bystander bystander(server);
  Wire silent(server.port());
  EXPECT_EQ(silent.answer().said.value("code", ""), "limit_exceeded");
  EXPECT_TRUE(silent.ends());
  Wire half(server.port());
  half.send("ANAV");
  EXPECT_EQ(half.answer().said.value("code", ""), "limit_exceeded");
  EXPECT_TRUE(half.ends());
}

TEST(ServerLimits, SilentConnectionsTakeNobodysPlace) {
  const RunningServer server(with([](Limits& l) {
    l.sessions = 2;
    l.greetings = 8;
    l.hello_s = 600.0;
  }));
  std::vector<std::unique_ptr<Wire>> silent;
  for (int i = 0; i < 40; ++i) silent.push_back(std::make_unique<Wire>(server.port()));
  Client client = server.client();
  EXPECT_TRUE(client.ping());
  // The oldest have been closed, the newest may still speak: 8 are kept, and the client was one of them.
  EXPECT_TRUE(silent.front()->ends());
  silent.back()->hello();
  EXPECT_EQ(silent.back()->answer().type, 101);
  Wire third(server.port());
  third.hello();
  EXPECT_EQ(third.answer().said.value("code", ""), "limit_exceeded");
  for (int i = 0; i < 40; ++i) silent.push_back(std::make_unique<Wire>(server.port()));
  EXPECT_TRUE(client.ping());  // who has been greeted stays
}

TEST(ServerLimits, IdleClientsAreClosedButNotThoseWhoWaitForAnswers) {
  const RunningServer server(with([](Limits& l) { l.idle_s = 0.5; }));
  const Bystander bystander(server);
  Wire idle(server.port());
  idle.hello();
  EXPECT_EQ(idle.answer().type, 101);
  EXPECT_EQ(idle.answer().said.value("code", ""), "limit_exceeded");
  EXPECT_TRUE(idle.ends());
}

TEST(ServerLimits, MessagesThatNeverEndAreClosed) {
  const RunningServer server(with([](Limits& l) { l.message_s = 0.5; }));
  const Bystander bystander(server);
  // Promises more than it sends.
  Wire lying(server.port());
  lying.hello();
  EXPECT_EQ(lying.answer().type, 101);
  const std::string whole = message_head(MessageType::render, std::string(900'000, ' '));
  lying.send(whole.substr(0, 100'000));
  EXPECT_EQ(lying.answer().said.value("code", ""), "limit_exceeded");
  EXPECT_TRUE(lying.ends());
  // One byte now and then: that something comes is not enough.
  Wire slow(server.port());
  slow.hello();
  EXPECT_EQ(slow.answer().type, 101);
  std::atomic<bool> closed = false;
  std::thread dripping([&] {
    for (std::size_t i = 0; !closed && i < whole.size() && slow.send(whole.substr(i, 1)); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
  });
  EXPECT_EQ(slow.answer().said.value("code", ""), "limit_exceeded");
  EXPECT_TRUE(slow.ends());
  closed = true;
  dripping.join();
}

TEST(ServerLimits, ClientThatDoesNotReadIsClosed) {
  const RunningServer server(with([](Limits& l) { l.write_s = 0.5; }));
  const Bystander bystander(server);
  Wire deaf(server.port(), 4096);
  deaf.hello();
  EXPECT_EQ(deaf.answer().type, 101);
  deaf.say(MessageType::trajectory, R"({"id":1,"start":"2027-03-01","stop":"2027-03-02","step_s":1,"camera":"small",)"
                                    R"("attitude":{"ra_deg":84,"dec_deg":0}})");
  // Until the server's side has gone, what is sent is taken; then it is refused.
  bool refused = false;
  for (int i = 0; i < 10 * kPatienceS && !refused; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    refused = !deaf.say(MessageType::ping, R"({"id":2})");
  }
  EXPECT_TRUE(refused);
}

// Turning as fast as the server lets it.
SceneRequest costliest(Client& client) {
  SceneRequest scene;
  scene.epoch = *Epoch::parse("2027-03-01");
  scene.pointing = Pointing{83.0 * kDegree, -1.0 * kDegree, 0.0};
  scene.rate_C_rad_s = Vec3::Zero();
  Result<Frame> frame = fail(ErrorCode::internal, "");
  for (double deg_s = 0.5; deg_s < 74.0; deg_s *= 1.2) {
    SceneRequest faster = scene;
    faster.rate_C_rad_s = Vec3(0.0, deg_s * kDegree, 0.0);
    frame = client.render(faster);
    if (!frame) break;
    scene = faster;
  }
  EXPECT_FALSE(frame);
  if (!frame) {
    EXPECT_EQ(frame.error().code, ErrorCode::limit_exceeded);
    EXPECT_NE(describe(frame.error()).find("rate_deg_s: the light of this scene takes"), std::string::npos)
        << describe(frame.error());
  }
  EXPECT_GT(scene.rate_C_rad_s->norm(), 0.0);
  return scene;
}

TEST(ServerLimits, CostlyScenesAreRefused) {
  const RunningServer server;
  Client client = server.client();
  SceneRequest scene;
  scene.epoch = *Epoch::parse("2027-03-01");
  scene.pointing = Pointing{83.0 * kDegree, -1.0 * kDegree, 0.0};
  scene.max_v_mag = 20.0;
  scene.rate_C_rad_s = Vec3(0.0, 70.0 * kDegree, 0.0);
  auto frame = client.render(scene);
  ASSERT_FALSE(frame);
  EXPECT_EQ(frame.error().code, ErrorCode::limit_exceeded);
  EXPECT_NE(describe(frame.error()).find("at most 200000000"), std::string::npos) << describe(frame.error());
  scene.format = PixelFormat::none;  // nothing is painted
  EXPECT_TRUE(client.render(scene));
  scene.format = PixelFormat::electrons;
  EXPECT_FALSE(client.render(scene));
  scene.effects = {{"motion", false}};
  EXPECT_TRUE(client.render(scene));
  // Without motion: a large picture of wide stars.
  std::string toml = kSmallCamera;
  for (const auto& [from, to] : {std::pair{"width_px = 64", "width_px = 2048"},
                                 {"height_px = 48", "height_px = 2048"},
                                 {"sigma_px = 0.8", "sigma_px = 0.8\nhalo_fraction = 0.5\nhalo_sigma_px = 100.0"},
                                 {"pupil_diameter_mm = 10.0", "pupil_diameter_mm = 100.0"}}) {
    toml.replace(toml.find(from), std::string_view(from).size(), to);
  }
  scene.effects = {};
  scene.rate_C_rad_s = Vec3::Zero();
  scene.camera_toml = toml;
  frame = client.render(scene);
  ASSERT_FALSE(frame);
  EXPECT_NE(describe(frame.error()).find("max_v_mag: the light of this scene takes"), std::string::npos)
      << describe(frame.error());
  scene.camera_toml = std::string(kSmallCamera) + "cosmic_rays_cm2_s = 1e6\n";
  scene.exposure_s = 1e4;
  scene.format = PixelFormat::dn;
  frame = client.render(scene);
  ASSERT_FALSE(frame);
  EXPECT_NE(describe(frame.error()).find("exposure_ms: the protons of this exposure take"), std::string::npos)
      << describe(frame.error());
  EXPECT_TRUE(client.ping());
}

TEST(ServerLimits, ClientIsServedWhileOthersAskForTheCostliest) {
  ServerSettings settings;
  settings.workers = 1;
  settings.limits.scene_work = 5e6;
  settings.drain_s = 1.0;
  const RunningServer server(settings);
  Client client = server.client();
  const SceneRequest heavy = costliest(client);
  SceneRequest light = heavy;
  light.camera = "small";
  light.rate_C_rad_s = Vec3::Zero();
  ASSERT_TRUE(client.render(light));

  std::atomic<bool> over = false;
  std::atomic<int> taken = 0;
  const auto keep_asking = [&](bool new_detectors) {
    Client asker = server.client();
    SceneRequest scene = heavy;
    for (std::uint64_t i = 0; i < 8; ++i) (void)asker.send(scene);
    Frame frame;
    for (std::uint64_t i = 0; !over && asker.receive(frame); ++i) {
      ++taken;
      if (new_detectors) scene.detector_seed = i + 2;  // each has to be made
      (void)asker.send(scene);
    }
  };
  std::thread first(keep_asking, false), second(keep_asking, true);
  while (taken < 4) std::this_thread::yield();
  // How many of the others' pictures come while one of its own is waited for: one of each at most, and one that was
  // done before and is on its way.
  std::vector<int> waited;
  for (int i = 0; i < 15; ++i) {
    const int before = taken;
    ASSERT_TRUE(client.render(light));
    waited.push_back(taken - before);
  }
  over = true;
  first.join();
  second.join();
  std::ranges::sort(waited);
  EXPECT_LE(waited[7], 3);
}

TEST(ServerLimits, StoppingWaitsForNoPictureThatIsNotBegun) {
  ServerSettings settings;
  settings.workers = 1;
  settings.drain_s = 0.0;
  settings.limits.scene_work = 5e6;
  RunningServer server(settings);
  std::vector<Client> clients;
  for (int i = 0; i < 8; ++i) clients.push_back(server.client());
  const SceneRequest heavy = costliest(clients[0]);
  constexpr int kEach = 40;
  for (Client& client : clients) {
    for (int i = 0; i < kEach; ++i) ASSERT_TRUE(client.send(heavy));
  }
  Frame frame;
  ASSERT_TRUE(clients[0].receive(frame));
  server.server().stop();
  server.join();
  int got = 0;
  for (Client& client : clients) {
    while (client.receive(frame)) ++got;
  }
  EXPECT_LT(got, 8 * kEach / 2);
}

double resident_megabytes() {
  std::ifstream status("/proc/self/statm");
  double all = 0.0, resident = 0.0;
  status >> all >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) * 1e-6;
}

TEST(ServerLimits, ClientThatDoesNotReadHoldsNoMoreThanItsRoom) {
  const RunningServer server(with([](Limits& l) { l.queued_bytes = 8 << 20; }));
  Client client = server.client();
  SceneRequest scene;
  scene.pointing = Pointing{1.0, 0.5, 0.0};
  const Epoch start = *Epoch::parse("2027-03-01");
  scene.epoch = start;
  ASSERT_TRUE(client.render(scene));  // everything that is made once
  const double before = resident_megabytes();
  constexpr int kFrames = 300;  // 630 MB, if they were kept
  ASSERT_TRUE(client.send_trajectory(scene, start, start + Duration::seconds(kFrames - 1), 1.0));
  for (int i = 0; i < 20; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    EXPECT_LT(resident_megabytes(), before + 150.0);
  }
  Frame frame;
  for (int i = 0; i < kFrames; ++i) ASSERT_TRUE(client.receive(frame)) << i;
  ASSERT_TRUE(client.receive(frame));
  EXPECT_TRUE(frame.end);
}

TEST(ServerLimits, EagerClientIsReadAsThereIsRoomAndEverythingIsAnswered) {
  const RunningServer server(with([](Limits& l) { l.queued_requests = 4; }));
  const Bystander bystander(server);
  Wire eager(server.port());
  eager.hello();
  constexpr int kAsked = 300;
  std::string all;
  for (int i = 1; i <= kAsked; ++i) {
    const std::string id = "{\"id\":" + std::to_string(i);
    all += i % 10 == 0 ? message_head(MessageType::render, id + std::string(kScene).substr(7))
                       : message_head(MessageType::ping, id + "}");
  }
  ASSERT_TRUE(eager.send(all));
  eager.end();  // half closed: the answers come nevertheless
  EXPECT_EQ(eager.answer().type, 101);
  for (int i = 1; i <= kAsked; ++i) {
    const Wire::Answer answer = eager.answer();
    ASSERT_EQ(answer.type, i % 10 == 0 ? 103 : 106) << i << answer.said;
    EXPECT_EQ(answer.said["id"], i);
    if (i % 10 == 0) {
      EXPECT_EQ(answer.binary.size(), 2u * 1024 * 1024);
    }
  }
  EXPECT_TRUE(eager.ends());
}

TEST(ServerLimits, ClientsThatVanishLeaveNothingBehind) {
  const RunningServer server(with([](Limits& l) { l.sessions = 4; }));
  const Bystander bystander(server);
  for (int i = 0; i < 12; ++i) {
    // Gone with a trajectory under way; the slot is free again at last, or connecting fails below.
    Result<Client> client = Client::connect("127.0.0.1", server.port());
    for (int j = 0; j < 600 && !client; ++j) {
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      client = Client::connect("127.0.0.1", server.port());
    }
    ASSERT_TRUE(client);
    SceneRequest scene;
    scene.pointing = Pointing{1.0, 0.5, 0.0};
    const Epoch start = *Epoch::parse("2027-03-01");
    ASSERT_TRUE(client->send_trajectory(scene, start, start + Duration::days(1.0), 1.0));
    Frame frame;
    if (i % 2 == 0) {
      ASSERT_TRUE(client->receive(frame));
    }
  }
}

TEST(ServerLimits, StoppingFinishesWhatWasAsked) {
  RunningServer server;
  Client client = server.client();
  Client idle = server.client();
  SceneRequest scene;
  scene.epoch = *Epoch::parse("2027-03-01");
  scene.pointing = Pointing{1.0, 0.5, 0.0};
  ASSERT_TRUE(client.render(scene));
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(client.send(scene));
  // What has arrived counts as asked: the first answer shows that the requests are being read.
  Frame frame;
  ASSERT_TRUE(client.receive(frame));
  server.server().stop();
  for (int i = 1; i < 10; ++i) ASSERT_TRUE(client.receive(frame)) << i;
  EXPECT_FALSE(client.receive(frame));  // the end of the connection
  EXPECT_FALSE(idle.ping());
  server.join();
  EXPECT_FALSE(Client::connect("127.0.0.1", server.port()));
}

TEST(ServerLimits, StoppingWaitsNoLongerThanItSays) {
  ServerSettings settings;
  settings.drain_s = 0.3;
  RunningServer server(settings);
  Client client = server.client();
  SceneRequest scene;
  scene.pointing = Pointing{1.0, 0.5, 0.0};
  const Epoch start = *Epoch::parse("2027-03-01");
  ASSERT_TRUE(client.send_trajectory(scene, start, start + Duration::seconds(900'000.0), 1.0));
  Frame frame;
  ASSERT_TRUE(client.receive(frame));
  server.server().stop();
  server.join();
  while (client.receive(frame)) EXPECT_FALSE(frame.end);
}

}  // namespace
}  // namespace astronav::server
