// The options of the live view, and the server that they ask for.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/status/status_line.h"
#include "core/config.h"
#include "view/view_server.h"

namespace b3dgs {

struct ViewOptions {
  int port = -1;  // -1: the first free one
  std::string address = "127.0.0.1";
};

/// Starts the server and says how to reach it; warns if other machines can. @throws InputError if it cannot listen
std::unique_ptr<ViewServer> start_view_server(FrameSource& source, const ViewOptions& options, StatusLine& status);

/// "--view 8080" as "--view --view_port 8080".
std::vector<std::string> split_view_port(const std::vector<std::string>& words);

}  // namespace b3dgs
