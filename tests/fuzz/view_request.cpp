// Requests of the live view's page: Host and Origin, a number of the query, and a body of JSON, in this order.
#include "app/view/access.h"
#include "app/view/view_json.h"
#include "fuzz/fuzz_target.h"
#include "model/cameras/cameras_json.h"

namespace b3dgs::fuzz {
namespace {

ViewedScene scene_of_two() {
  ViewedScene scene;
  for (const bool has_photograph : {true, false}) {
    ViewedCamera view;
    view.has_photograph = has_photograph;
    view.camera.width = 640;
    view.camera.height = 480;
    view.camera.fx = view.camera.fy = 500;
    scene.views.push_back(view);
  }
  return scene;
}

void check_frame(const FrameRequest& request, const ViewedScene& scene) {
  const Camera& camera = request.camera;
  B3DGS_CHECK(camera.width > 0 && camera.height > 0 && std::int64_t{camera.width} * camera.height <= kMaxFramePixels,
              "a picture of ", camera.width, " x ", camera.height);
  B3DGS_CHECK(camera_fault(camera).empty(), camera_fault(camera));
  B3DGS_CHECK(request.quality >= 1 && request.quality <= 100, "quality ", request.quality);
  B3DGS_CHECK(request.view >= -1 && request.view < static_cast<int>(scene.views.size()), "view ", request.view);
  B3DGS_CHECK(
      request.mode != FrameMode::kDifference || scene.views.at(static_cast<std::size_t>(request.view)).has_photograph,
      "no photograph");
}

}  // namespace

void read_input(std::string_view bytes) {
  static const ViewedScene scene = scene_of_two();
  const std::vector<std::string_view> parts = split_files(bytes, 3);
  const std::string host(parts[0]), number(parts[1]), body(parts[2]);
  if (is_own_host(host, "127.0.0.1")) {
    B3DGS_CHECK(is_own_host(host, "0.0.0.0"), "an address that is refused where more are allowed");
    B3DGS_CHECK(is_own_origin("http://" + host, host) && !is_own_origin("http://" + host + "x", host), "origin");
  }
  const bool is_command = body.find("command") != std::string::npos;
  if (is_command) {
    parse_command(body);
  } else {
    check_frame(parse_frame_request(body, scene), scene);
  }
  const int value = parse_whole_number(number, "since");
  B3DGS_CHECK(value >= 0 && std::to_string(value).size() <= number.size(), "a number of ", value);
  for (const bool may_enlarge : {false, true}) fit_view(scene, value, {640, 480}, may_enlarge);
}

}  // namespace b3dgs::fuzz
