#include "app/view/view_json.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>

#include "core/check.h"
#include "core/json_text.h"
#include "core/vec.h"
#include "scene/cameras/camera.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kModes[] = {"render", "difference", "depth", "alpha", "load"};  // in the order of FrameMode
constexpr const char* kCommands[] = {"pause", "resume", "save", "stop"};              // in the order of ViewCommand
constexpr int kMinSide = 16, kMaxSide = 16384;                                        // px
constexpr double kMaxCoordinate = 1e9;                                                // world units

Json parse_object(const std::string& body, const char* expected) {
  const Json json = parse_json(body);
  if (!json.is_object()) input_error("not a JSON object (expected ", expected, ")");
  return json;
}

const Json& member(const Json& json, const char* key) {
  const auto found = json.find(key);
  if (found == json.end()) input_error("missing: \"", key, "\"");
  return *found;
}

double number(const Json& json, const std::string& what, double least, double most) {
  const double value = json.is_number() ? json.get<double>() : std::nan("");
  if (!(value >= least && value <= most)) input_error(what, ": expected a number from ", least, " to ", most);
  return value;
}

int whole_number(const Json& json, const std::string& what, int least, int most) {
  const double value = number(json, what, least, most);
  if (value != std::floor(value)) input_error(what, ": expected a whole number");
  return static_cast<int>(value);
}

ImageSize check_size(ImageSize size) {
  if (size.width < kMinSide || size.height < kMinSide || size.width > kMaxSide || size.height > kMaxSide ||
      std::int64_t{size.width} * size.height > kMaxFramePixels) {
    input_error("size: expected at least ", kMinSide, " px a side and at most ", kMaxFramePixels, " pixels, found ",
                size.width, " x ", size.height);
  }
  return size;
}

/// Returns the index of a word among the allowed ones. @throws InputError naming `what` and all words
template <std::size_t n>
int choice(const Json& json, const char* what, const char* const (&words)[n]) {
  const auto found = std::find(std::begin(words), std::end(words), json);
  if (found != std::end(words)) return static_cast<int>(found - std::begin(words));
  std::string list;
  for (const char* word : words) list += (list.empty() ? "" : ", ") + std::string(word);
  input_error(what, ": expected one of ", list);
}

Camera parse_camera(const Json& json, ImageSize size) {
  if (!json.is_object()) input_error("camera: expected an object");
  const Json& list = member(json, "camera_to_world");
  OpenGlMatrix m{};
  if (!list.is_array() || list.size() != m.size()) input_error("camera_to_world: expected 16 numbers");
  for (std::size_t i = 0; i < m.size(); ++i) m[i] = number(list[i], "camera_to_world", -kMaxCoordinate, kMaxCoordinate);
  const double fov = number(member(json, "fov"), "fov", 1, 170);
  return Camera::with_field_of_view(size.width, size.height, fov, pose_from_opengl(m, "camera_to_world"));
}

}  // namespace

ImageSize fit_view(const ViewedScene& scene, int view, ImageSize within, bool may_enlarge) {
  check_size(within);
  if (view < 0 || view >= static_cast<int>(scene.views.size())) {
    input_error("view: expected a number from 0 to ", static_cast<int>(scene.views.size()) - 1, ", found ", view);
  }
  const Camera& camera = scene.views[static_cast<std::size_t>(view)].camera;
  double scale =
      std::min(within.width / static_cast<double>(camera.width), within.height / static_cast<double>(camera.height));
  if (!may_enlarge) scale = std::min(1.0, scale);
  const auto scaled = [&](int side) { return std::max(1, static_cast<int>(std::lround(scale * side))); };
  return {scaled(camera.width), scaled(camera.height)};
}

FrameRequest parse_frame_request(const std::string& body, const ViewedScene& scene) {
  const Json json = parse_object(body, R"({"width": ...})");
  const ImageSize size = check_size({whole_number(member(json, "width"), "width", 1, kMaxSide),
                                     whole_number(member(json, "height"), "height", 1, kMaxSide)});
  FrameRequest request;
  if (json.contains("mode")) request.mode = static_cast<FrameMode>(choice(json["mode"], "mode", kModes));
  if (json.contains("quality")) request.quality = whole_number(json["quality"], "quality", 1, 100);
  if (json.contains("draft")) {
    if (!json["draft"].is_boolean()) input_error("draft: expected true or false");
    request.is_draft = json["draft"].get<bool>();
  }
  if (json.contains("pick")) {
    const Json& place = json["pick"];
    if (!place.is_array() || place.size() != 2) input_error("pick: expected 2 numbers");
    request.pick = {number(place[0], "pick", 0, 1), number(place[1], "pick", 0, 1)};
  }
  if (json.contains("view")) {
    request.view = whole_number(json["view"], "view", 0, 1'000'000'000);
    const ImageSize fitted = fit_view(scene, request.view, size, request.mode != FrameMode::kDifference);
    request.camera = scene.views[static_cast<std::size_t>(request.view)].camera.scaled_to(fitted.width, fitted.height);
  } else {
    request.camera = parse_camera(member(json, "camera"), size);
  }
  if (request.mode == FrameMode::kDifference &&
      (request.view < 0 || !scene.views[static_cast<std::size_t>(request.view)].has_photograph)) {
    input_error("mode difference: expected a view with a photograph");
  }
  return request;
}

ViewCommand parse_command(const std::string& body) {
  const Json json = parse_object(body, R"({"command": "pause"})");
  return static_cast<ViewCommand>(choice(member(json, "command"), "command", kCommands));
}

int parse_whole_number(const std::string& text, const std::string& what) {
  const bool is_number = !text.empty() && text.size() <= 9 &&
                         std::all_of(text.begin(), text.end(), [](unsigned char c) { return c >= '0' && c <= '9'; });
  if (!is_number) input_error(what, ": expected a whole number");
  return std::atoi(text.c_str());
}

Json cameras_json(const ViewedScene& scene) {
  Json views = Json::array();
  for (const ViewedCamera& view : scene.views) {
    const Camera &camera = view.camera, pinhole = camera.without_lens();
    views.push_back({{"name", view.name},
                     {"test", view.is_test},
                     {"photograph", view.has_photograph},
                     {"width", camera.width},
                     {"height", camera.height},
                     {"fov", 2 * std::atan(0.5 * pinhole.height / pinhole.fy) * 180 / kPi},
                     {"camera_to_world", opengl_from_pose(camera.cam_from_world)}});
  }
  return {{"title", scene.title},
          {"training", scene.is_training},
          {"center", scene.center},
          {"radius", scene.radius},
          {"origin", scene.frame.origin},
          {"unit", scene.frame.unit},
          {"up", scene.up ? Json(*scene.up) : Json()},
          {"metric", scene.is_metric},
          {"views", views}};
}

Json state_json(const ViewState& state) {
  Json curve = Json::array(), psnr = Json::array();
  for (const CurvePoint& point : state.curve) curve.push_back({point.iteration, point.loss, point.n_gaussians});
  for (const PsnrPoint& point : state.psnr) psnr.push_back({point.iteration, point.psnr});
  return {{"iteration", state.iteration},
          {"iterations", state.iterations},
          {"loss", state.loss},
          {"count", state.n_gaussians},
          {"kernel", state.kernel},
          {"activity", state.activity},
          {"notice", state.notice},
          {"warning", state.is_warning},
          {"per_second", state.iterations_per_second},
          {"eta_s", state.eta_s ? Json(*state.eta_s) : Json(nullptr)},
          {"paused", state.is_paused},
          {"ended", state.has_ended},
          {"curve", curve},
          {"psnr", psnr}};
}

Json frame_json(const Frame& frame) {
  return {{"iteration", frame.iteration},
          {"count", frame.n_gaussians},
          {"ms", frame.render_ms},
          {"wait_ms", 1000 * frame.wait_s},
          {"point", frame.point ? Json(*frame.point) : Json()},
          {"legend", frame.legend}};
}

std::string json_text(const Json& json) {
  return json.dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace);
}

}  // namespace b3dgs
