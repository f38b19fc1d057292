// SPDX-License-Identifier: Apache-2.0
// The live view's HTTP, over loopback, as a browser and as others would speak it.
#include <algorithm>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "foundation/raster/raster.h"
#include "simulator/server/http.h"
#include "simulator/server/server_for_tests.h"
#include "support/program.h"

namespace astronav::server {
namespace {

using nlohmann::json;

struct Got {
  int status = 0;  // 0: the connection ended without an answer
  std::string head, body;
};

class Browser {
 public:
  explicit Browser(std::uint16_t port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  }
  ~Browser() { ::close(socket_); }
  Browser(const Browser&) = delete;
  Browser& operator=(const Browser&) = delete;

  void send(std::string_view bytes) { (void)::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL); }
  Got read() {
    Got got;
    while (!http_head_length(got.head) && more(got.head)) {
    }
    const auto length = http_head_length(got.head);
    if (!length) return got;
    got.body = got.head.substr(*length);
    got.head.resize(*length);
    got.status = std::stoi(got.head.substr(9, 3));
    const std::size_t at = got.head.find("Content-Length: ");
    const std::size_t size = std::stoul(got.head.substr(at + 16));
    while (got.body.size() < size && more(got.body)) {
    }
    EXPECT_EQ(got.body.size(), size);
    return got;
  }
  Got get(const std::string& target, const std::string& fields = "Host: localhost\r\n") {
    send("GET " + target + " HTTP/1.1\r\n" + fields + "\r\n");
    return read();
  }

 private:
  bool more(std::string& out) {
    pollfd one{socket_, POLLIN, 0};
    if (poll(&one, 1, 60'000) <= 0) return false;
    char buffer[65536];
    const ssize_t n = ::recv(socket_, buffer, sizeof buffer, 0);
    if (n > 0) out.append(buffer, static_cast<std::size_t>(n));
    return n > 0;
  }
  int socket_;
};

std::string encoded(const json& scene) {
  std::string out;
  for (const char c : scene.dump()) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
    char hex[4];
    std::snprintf(hex, sizeof hex, "%%%02X", static_cast<unsigned char>(c));
    out += plain ? std::string(1, c) : std::string(hex);
  }
  return "?scene=" + out;
}

const json kScene{{"epoch", "2027-03-01T00:00:00 TDB"},
                  {"observer", "mars"},
                  {"camera", "extrema-20deg"},
                  {"attitude", {{"ra_deg", 84.0}, {"dec_deg", 0.5}}}};

ServerSettings with_web(const std::string& token = {}) {
  ServerSettings settings;
  settings.web_port = 0;
  settings.token = token;
  return settings;
}

Picture picture_of(const std::string& png) {
  const testing::ScratchFolder folder;
  testing::write_text(folder.path() / "x.png", png);
  const auto picture = read_picture(folder.path() / "x.png");
  EXPECT_TRUE(picture);
  return picture ? *picture : Picture{};
}

TEST(Http, ReadsTheHeadOfARequest) {
  const auto request = parse_http(
      "GET /api/truth?scene=%7B%22a%22:+1%7D&x HTTP/1.1\r\nHOST: [::1]:8080\r\nAuthorization: Bearer  abc \r\n"
      "Connection: close\r\n\r\n");
  ASSERT_TRUE(request);
  EXPECT_EQ(request->method, "GET");
  EXPECT_EQ(request->path, "/api/truth");
  EXPECT_EQ(request->query.at("scene"), "{\"a\": 1}");
  EXPECT_EQ(request->query.at("x"), "");
  EXPECT_EQ(request->host, "[::1]");
  EXPECT_EQ(request->token, "abc");
  EXPECT_FALSE(request->keep_alive);
  for (const char* bad :
       {"", "\r\n\r\n", "GET\r\n\r\n", "GET /\r\n\r\n", "GET / HTTP/2\r\n\r\n", "GET x HTTP/1.1\r\n\r\n",
        "GET /%4 HTTP/1.1\r\n\r\n", "GET /%zz HTTP/1.1\r\n\r\n", "GET /?a=%f HTTP/1.1\r\n\r\n",
        "GET / HTTP/1.1\r\nno colon\r\n\r\n", "GET / HTTP/1.1\r\n: x\r\n\r\n", "GET / HTTP/1.1\r\nx: y"})
    EXPECT_FALSE(parse_http(bad)) << bad;
  EXPECT_FALSE(parse_http("GET / HTTP/1.1\r\nContent-Length: 5\r\n\r\n"));
  EXPECT_FALSE(parse_http("GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n"));
}

TEST(LiveView, ServesThePageAndTheApi) {
  const RunningServer server(with_web());
  const std::uint16_t port = server.web_port();
  ASSERT_NE(port, 0);
  Browser browser(port);  // one connection for all
  const Got page = browser.get("/");
  EXPECT_EQ(page.status, 200);
  EXPECT_NE(page.head.find("text/html"), std::string::npos);
  EXPECT_NE(page.head.find("Content-Security-Policy: default-src 'none'"), std::string::npos);
  EXPECT_NE(page.body.find("createImageBitmap"), std::string::npos);
  EXPECT_EQ(page.body.find("https://"), std::string::npos);  // nothing comes from elsewhere

  const json info = json::parse(browser.get("/api/info").body);
  EXPECT_EQ(info["cameras"].size(), 3u);
  EXPECT_EQ(info["settings"]["camera"], "extrema-20deg");

  const Got view = browser.get("/api/view.png" + encoded(kScene));
  ASSERT_EQ(view.status, 200) << view.body;
  const Picture eight = picture_of(view.body);
  EXPECT_EQ(eight.bits, 8);
  EXPECT_EQ(eight.pixels.width(), 1024);
  // The eye sees something: the sky dark but not black, a few pixels white.
  double sum = 0.0;
  int white = 0;
  for (const float value : eight.pixels.pixels()) {
    sum += static_cast<double>(value);
    white += value > 250.0f ? 1 : 0;
  }
  EXPECT_GT(sum / 1024 / 1024, 4.0);
  EXPECT_LT(sum / 1024 / 1024, 80.0);
  EXPECT_GT(white, 3);
  EXPECT_LT(white, 2000);

  const Got frame = browser.get("/api/frame.png" + encoded(kScene));
  ASSERT_EQ(frame.status, 200) << frame.body;
  Client client = server.client();
  SceneRequest scene;
  scene.epoch = *Epoch::parse("2027-03-01T00:00:00 TDB");
  scene.observer = "mars";
  scene.pointing = Pointing{84.0 * kDegree, 0.5 * kDegree, 0.0};
  scene.truth = true;
  const auto same = client.render(scene);
  ASSERT_TRUE(same);
  EXPECT_TRUE(std::ranges::equal(picture_of(frame.body).pixels.pixels(), same->dn.pixels(),
                                 [](float a, std::uint16_t b) { return a == static_cast<float>(b); }));

  const json truth = json::parse(browser.get("/api/truth" + encoded(kScene)).body);
  EXPECT_EQ(truth["sources"].size(), same->truth.size());

  const json sky = json::parse(browser.get("/api/sky" + encoded(kScene)).body);
  EXPECT_GT(sky["stars"].size(), 700u);  // 900 stars or so to V 4.5
  EXPECT_LT(sky["stars"].size(), 1200u);
  EXPECT_EQ(sky["field"].size(), 64u);
  EXPECT_NEAR(sky["ra_deg"].get<double>(), 84.0, 1e-9);
  std::vector<std::string> names;
  for (const json& each : sky["bodies"]) names.push_back(each["name"]);
  EXPECT_NE(std::ranges::find_if(names, [](const auto& n) { return n.starts_with("jupiter"); }), names.end());
  EXPECT_NEAR(sky["sun"]["distance_km"].get<double>(), 2.3e8, 0.3e8);
}

TEST(LiveView, LatestIsWhatAClientWasShown) {
  const RunningServer server(with_web());
  Browser browser(server.web_port());
  EXPECT_EQ(json::parse(browser.get("/api/latest").body), json({{"frames", 0}, {"scene", nullptr}}));
  Client client = server.client();
  SceneRequest scene;
  scene.epoch = *Epoch::parse("2027-03-01T00:00:00 TDB");
  scene.body = "mars";
  scene.camera = "small";
  ASSERT_TRUE(client.render(scene));
  const json latest = json::parse(browser.get("/api/latest").body);
  EXPECT_EQ(latest["frames"], 1);
  EXPECT_EQ(latest["scene"]["camera"], "small");
  // It can be asked for as it is.
  const Got again = browser.get("/api/view.png" + encoded(latest["scene"]));
  ASSERT_EQ(again.status, 200) << again.body;
  EXPECT_EQ(picture_of(again.body).pixels.width(), 64);
}

TEST(LiveView, WhatIsWrongIsSaid) {
  const RunningServer server(with_web());
  struct Wrong {
    std::string target;
    int status;
    const char* code;
  };
  json file = kScene, late = kScene, unknown = kScene;
  file["observer"] = "oem:/etc/passwd";
  late["epoch"] = "2100-01-01";
  unknown["exposure"] = 5;
  Browser browser(server.web_port());
  for (const Wrong& wrong :
       {Wrong{"/nothing", 404, "not_found"}, Wrong{"/api/nothing", 404, "not_found"},
        Wrong{"/../../etc/passwd", 404, "not_found"}, Wrong{"/api/truth?scene=[]", 400, "corrupt_data"},
        Wrong{"/api/truth?scene=" + std::string(50, '['), 413, "limit_exceeded"},
        Wrong{"/api/view.png" + encoded(file), 400, "unsupported"},
        Wrong{"/api/view.png" + encoded(late), 400, "out_of_range"},
        Wrong{"/api/sky" + encoded(unknown), 400, "invalid_argument"}}) {
    const Got got = browser.get(wrong.target);
    EXPECT_EQ(got.status, wrong.status) << wrong.target;
    EXPECT_EQ(json::parse(got.body)["code"], wrong.code) << wrong.target;
  }
  // The same connection has been good for all; these end it.
  EXPECT_EQ(browser.get("/", "Host: evil.example\r\n").status, 403);
  for (const std::string& bytes :
       {std::string("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), std::string("ANAV\r\n\r\n"),
        std::string("GET / HTTP/1.1\r\nContent-Length: 10\r\n\r\n"), "GET /" + std::string(200'000, 'x')}) {
    Browser bad(server.web_port());
    bad.send(bytes);
    EXPECT_GE(bad.read().status, 400) << bytes.substr(0, 40);
    EXPECT_EQ(bad.read().status, 0);
  }
  EXPECT_EQ(Browser(server.web_port()).get("/").status, 200);
}

TEST(LiveView, TokenIsAskedForBeforeTheApiAnswers) {
  const RunningServer server(with_web("secret"));
  Browser browser(server.web_port());
  EXPECT_EQ(browser.get("/").status, 200);  // holds nothing but itself
  EXPECT_EQ(browser.get("/api/info").status, 401);
  EXPECT_EQ(browser.get("/api/info", "Authorization: Bearer secre\r\n").status, 401);
  EXPECT_EQ(browser.get("/api/info", "Authorization: Bearer secret\r\n").status, 200);
}

TEST(LiveView, ManyConnectionsAndHalfRequestsHarmNobody) {
  const RunningServer server(with_web());
  std::vector<std::unique_ptr<Browser>> silent;
  for (int i = 0; i < 20; ++i) {
    silent.push_back(std::make_unique<Browser>(server.web_port()));
    silent.back()->send("GET / HT");
  }
  Browser browser(server.web_port());
  EXPECT_EQ(browser.get("/api/truth" + encoded(kScene)).status, 200);
  EXPECT_TRUE(server.client().ping());
}

}  // namespace
}  // namespace astronav::server
