// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "models/camera_file/camera_file.h"
#include "simulator/server/server.h"

namespace astronav::cli {
namespace {

struct Options {
  std::string listen = "127.0.0.1";
  std::uint16_t port = 4242;
  int web_port = -1;
  std::string token_file;
  unsigned workers = 0;
  std::uint32_t sessions = 16;
  std::vector<std::string> cameras;
  std::vector<std::string> observers;
  std::vector<std::string> kernels;
  std::string catalogue;
  bool json = false;
};

// The first line of the file, or of the environment's ASTRONAV_TOKEN: arguments can be read by everybody on a machine.
Result<std::string> read_token(const std::string& path) {
  std::string text;
  if (!path.empty()) {
    const auto file = MappedFile::open(path);
    if (!file) return forward(file, path);
    text = std::string(file->text());
  } else if (const char* variable = std::getenv("ASTRONAV_TOKEN")) {
    text = variable;
  }
  text = text.substr(0, text.find_first_of("\r\n"));
  if (!path.empty() && text.empty()) {
    return fail(ErrorCode::invalid_argument, "the first line holds no token", {}, path);
  }
  return text;
}

Result<void> add_camera(const std::filesystem::path& file, server::Registry& registry) {
  auto camera = read_camera(file);
  if (!camera) return forward(camera);
  registry.cameras[file.stem().string()] = std::make_shared<const Camera>(std::move(*camera));
  return {};
}

// NAME=OBSERVER. A body's name cannot be taken: a client would not get the body.
Result<void> add_observer(const std::string& text, const std::shared_ptr<const Kernels>& kernels,
                          server::Registry& registry) {
  const std::size_t equals = text.find('=');
  const std::string name = text.substr(0, equals);
  if (equals == std::string::npos || name.empty() || name.find(':') != std::string::npos || parse_body(name)) {
    return fail(ErrorCode::invalid_argument,
                "'{s}' names no observer: expected NAME=spk:ID@FILE or NAME=oem:FILE, and no body's name", {},
                "--observer", text);
  }
  auto observer = parse_observer(std::string_view(text).substr(equals + 1), kernels);
  if (!observer) return forward(observer, "--observer");
  registry.observers[name] = std::move(*observer);
  return {};
}

Result<int> run(const Options& options) {
  server::ServerSettings settings;
  settings.address = options.listen;
  settings.port = options.port;
  if (options.web_port >= 0) settings.web_port = static_cast<std::uint16_t>(options.web_port);
  settings.workers = options.workers;
  settings.limits.sessions = options.sessions;
  settings.stop_on_signals = true;
  auto token = read_token(options.token_file);
  if (!token) return forward(token);
  settings.token = std::move(*token);

  // Any epoch tells whether the kernels lead from the planets to the barycentre at all.
  const auto kernels = open_kernels_for(options.kernels, {body::sun, body::earth}, Epoch());
  if (!kernels) return forward(kernels);
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  server::Registry registry;
  std::error_code none;
  std::filesystem::directory_iterator presets(home_directory() / "scenarios" / "cameras", none);
  for (; !none && presets != std::filesystem::directory_iterator(); presets.increment(none)) {
    if (presets->path().extension() != ".toml") continue;
    if (auto added = add_camera(presets->path(), registry); !added) return forward(added);
  }
  for (const std::string& file : options.cameras) {
    if (auto added = add_camera(file, registry); !added) return forward(added);
  }
  for (const std::string& text : options.observers) {
    if (auto added = add_observer(text, *kernels, registry); !added) return forward(added);
  }
  registry.parse_observer = [kernels = *kernels](std::string_view text) { return parse_observer(text, kernels); };
  registry.parse_ground_site = parse_ground_site;

  const auto server = server::Server::create(settings, std::move(registry), (*kernels)->ephemeris, catalogue->stars);
  if (!server) return forward(server, "--listen");
  const std::uint16_t web_port = (*server)->web_port();
  if (options.json) {
    nlohmann::ordered_json line{{"address", options.listen}, {"port", (*server)->port()}};
    line["web_port"] = web_port > 0 ? nlohmann::ordered_json(web_port) : nlohmann::ordered_json(nullptr);
    fmt::print("{}\n", line.dump());
  } else {
    fmt::print("serving on {} port {}\n", options.listen, (*server)->port());
    const bool six = options.listen.find(':') != std::string::npos;
    if (web_port > 0)
      fmt::print("live view: http://{}:{}/\n", six ? "[" + options.listen + "]" : options.listen, web_port);
  }
  std::fflush(stdout);
  (*server)->run();
  return 0;
}

}  // namespace

void add_serve(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("serve", "the SkySimulator: pictures for other programs (docs/protocol.md)");
  sub->footer("Example:\n  astronav serve --port 4242 --web-port 8080");
  sub->add_option("--port", options->port, "0: any that is free")
      ->check(number_within(0, 65535))
      ->capture_default_str();
  sub->add_option("--web-port", options->web_port, "live view for a browser")->check(number_within(0, 65535));
  sub->add_option("--listen", options->listen, "address; another than this machine's own demands a token")
      ->capture_default_str();
  sub->add_option("--token-file", options->token_file, "its first line; else the variable ASTRONAV_TOKEN");
  sub->add_option("--workers", options->workers, "threads that render; 0: one a processor")
      ->check(number_within(0, 256))
      ->capture_default_str();
  sub->add_option("--sessions", options->sessions, "clients at a time")
      ->check(number_within(1, 1000))
      ->capture_default_str();
  sub->add_option("--camera", options->cameras, "further camera files, known by their names without .toml");
  sub->add_option("--observer", options->observers, "NAME=spk:ID@FILE or NAME=oem:FILE, for clients to name");
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence");
  sub->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  sub->add_flag("--json", options->json, "address and ports as one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
