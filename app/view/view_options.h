// The option --view, and the server that it asks for.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/status/status_line.h"
#include "view/view_server.h"

namespace b3dgs {

/// Starts the server and says how to reach it; warns if other machines can. @throws InputError if it cannot listen
std::unique_ptr<ViewServer> start_view_server(FrameSource& source, const ViewServerOptions& options,
                                              StatusLine& status);

/// Of --view PLACE: "8080", "0.0.0.0:8080" or "auto". @throws InputError
ViewServerOptions parse_view_place(const std::string& place);

/// "--view 8080" as "--view=8080", and "--view" before anything else as "--view=auto".
std::vector<std::string> join_view_place(const std::vector<std::string>& words);

}  // namespace b3dgs
