#include "app/export/page_view.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "app/render/camera_path.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

constexpr double kLeastFov = 20, kMostFov = 100;  // degrees

/// In the frame of the Gaussians.
struct StartView {
  cv::Vec3d position{}, target{};
  double fov = Camera::kDefaultFov;  // along the longer side, degrees
};

StartView start_view(const LoadedModel& model) {
  const SplatBounds bounds = splat_bounds(model.splats);
  std::vector<Camera> cameras;
  for (const std::vector<View>* views : {&model.scene.train, &model.scene.test}) {
    for (const View& view : *views) cameras.push_back(view.camera);
  }
  StartView start;
  start.target = bounds.center;
  start.position = bounds.center + 3 * bounds.radius * cv::normalize(cv::Vec3d{0.6, -0.5, -1});
  if (cameras.empty()) return start;
  const Camera first = cameras[0].without_lens();
  const cv::Vec3d focus = focus_of(cameras, bounds.center);
  const auto& r = first.cam_from_world.rotation;
  start.position = cv::Vec3d(first.center().data());
  const double distance = std::max(cv::norm(focus - start.position), 1e-3 * bounds.radius);
  start.target = first.project(focus.val) ? focus : start.position + distance * cv::Vec3d{r[6], r[7], r[8]};
  const double slope = std::max(0.5 * first.width / first.fx, 0.5 * first.height / first.fy);
  start.fov = std::clamp(2 * std::atan(slope) * 180 / kPi, kLeastFov, kMostFov);
  return start;
}

}  // namespace

PageOptions page_view(const LoadedModel& model, const UnitQuat& rotation, double scale, const CoordinateFrame& frame) {
  const StartView start = start_view(model);
  // The viewer turns the file half around z: its y axis is up.
  const auto in_viewer = [&](const cv::Vec3d& position) {
    std::array<double, 3> world =
        rotated(rotation_from_quaternion(rotation), model.splats.frame.to_world(position.val));
    for (double& value : world) value *= scale;
    const std::array<double, 3> at = frame.from_world(world.data());
    return nlohmann::ordered_json::array({-at[0], -at[1], at[2]});
  };
  const double gray = model.config.white_background ? 1 : 0;
  // The first version of the viewer's settings, which later ones still read.
  const nlohmann::ordered_json settings{
      {"background", {{"color", {gray, gray, gray}}}},
      {"camera", {{"position", in_viewer(start.position)}, {"target", in_viewer(start.target)}, {"fov", start.fov}}},
      {"animTracks", nlohmann::ordered_json::array()}};
  const std::string path = model.is_file() ? model.file.stem().string() : model.folder.root().string();
  return {scene_name(std::filesystem::absolute(path).string()), dump_json(settings)};
}

}  // namespace b3dgs
