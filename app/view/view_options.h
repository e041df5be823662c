// The option --view, and the server that it starts.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/common/status_line.h"
#include "app/view/view_server.h"

namespace b3dgs {

/// Starts the server and prints its address. Warns if other machines can reach it. @throws InputError if it cannot
/// listen
std::unique_ptr<ViewServer> start_view_server(FrameSource& source, const ViewServerOptions& options,
                                              StatusLine& status);

/// Parses PLACE of --view PLACE: "8080", "0.0.0.0:8080" or "auto". @throws InputError
ViewServerOptions parse_view_place(const std::string& place);

/// Replaces "--view 8080" by "--view=8080", and "--view" before anything else by "--view=auto".
std::vector<std::string> join_view_place(const std::vector<std::string>& words);

}  // namespace b3dgs
