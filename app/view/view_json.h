// The server's JSON: parsing and checking of the page's requests, and the answers.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "app/view/frame_source.h"

namespace b3dgs {

inline constexpr std::int64_t kMaxFramePixels = 4'000'000;

/// The request of POST /frame:
///   {"width": 800, "height": 600, "mode": "render", "quality": 85, "draft": false, and one of
///    "view": 3,
///    "camera": {"camera_to_world": [16 numbers], "fov": 50}}
/// A view's camera is scaled to fit into the size. A camera of its own has that size; it is given as in the camera
/// paths that nerfstudio writes: row-major, OpenGL axes (+x right, +y up, -z forward), vertical field of view in
/// degrees.
/// @throws InputError, one line, for anything that is missing, not finite or out of range
FrameRequest parse_frame_request(const std::string& body, const ViewedScene& scene);

/// Parses the request of POST /command: {"command": "pause" | "resume" | "save" | "stop"}. @throws InputError
ViewCommand parse_command(const std::string& body);

/// Returns the largest size of the view's aspect ratio within a size, also above that of the view if `may_enlarge`.
/// @throws InputError if the size is out of range
ImageSize fit_view(const ViewedScene& scene, int view, ImageSize within, bool may_enlarge);

/// Parses an integer. @throws InputError naming `what`
int parse_whole_number(const std::string& text, const std::string& what);

nlohmann::ordered_json cameras_json(const ViewedScene& scene);
nlohmann::ordered_json state_json(const ViewState& state);
/// Returns the header X-Frame, with data about a frame.
nlohmann::ordered_json frame_json(const Frame& frame);

/// Returns `json` on one line of valid UTF-8, for any names of files.
std::string json_text(const nlohmann::ordered_json& json);

}  // namespace b3dgs
