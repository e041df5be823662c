#include "app/view/view_options.h"

#include <algorithm>
#include <iostream>

#include "view/access.h"

namespace b3dgs {

std::unique_ptr<ViewServer> start_view_server(FrameSource& source, const ViewOptions& options, StatusLine& status) {
  ViewServerOptions server;
  server.address = options.address;
  if (options.port >= 0) server.port = options.port;
  auto started = std::make_unique<ViewServer>(source, server);
  if (!is_loopback(options.address)) {
    status.warn("--view_address " + options.address +
                ": other machines can reach the page, and what is sent is not encrypted: whoever reads the token can "
                "watch and stop the training; an ssh tunnel to 127.0.0.1 is safer");
  }
  std::cout << started->instructions() << std::endl;
  return started;
}

std::vector<std::string> split_view_port(const std::vector<std::string>& words) {
  std::vector<std::string> result;
  for (std::size_t i = 0; i < words.size(); ++i) {
    result.push_back(words[i]);
    const bool has_port =
        words[i] == "--view" && i + 1 < words.size() && !words[i + 1].empty() &&
        std::all_of(words[i + 1].begin(), words[i + 1].end(), [](char c) { return c >= '0' && c <= '9'; });
    if (has_port) result.emplace_back("--view_port");
  }
  return result;
}

}  // namespace b3dgs
