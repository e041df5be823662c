#include "model/cameras/poses_json.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <map>
#include <string>

#include "core/check.h"
#include "core/json_text.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Angle between two orientations, degrees. By the sine of half the angle: the cosine of a small angle is about 1.
double angle_between(const Pose& a, const Pose& b) {
  double square = 0;  // of the matrices' difference: 8 sin^2(angle / 2)
  for (std::size_t i = 0; i < 9; ++i) square += (a.rotation[i] - b.rotation[i]) * (a.rotation[i] - b.rotation[i]);
  return 2 * std::asin(std::min(1.0, std::sqrt(square / 8))) * 180 / 3.14159265358979323846;
}

double distance_between(const Camera& a, const Camera& b) {
  const std::array<double, 3> p = a.center(), q = b.center();
  return std::sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]));
}

Pose pose_from_json(const Json& entry, const std::string& prefix, const std::string& place) {
  const auto qvec = entry.at(prefix + "qvec").get<std::array<double, 4>>();
  const double square = qvec[0] * qvec[0] + qvec[1] * qvec[1] + qvec[2] * qvec[2] + qvec[3] * qvec[3];
  if (!(std::abs(square - 1) < 1e-3)) input_error(place, ": expected a unit quaternion as ", prefix, "qvec");
  return {rotation_from_quaternion(qvec), entry.at(prefix + "tvec").get<std::array<double, 3>>()};
}

/// Equal up to rounding.
bool is_same(const Pose& a, const Pose& b) {
  constexpr double kTolerance = 1e-9;  // relative to the largest coordinate
  double size = 1, difference = 0;
  for (std::size_t i = 0; i < 9; ++i) difference = std::max(difference, std::abs(a.rotation[i] - b.rotation[i]));
  for (std::size_t i = 0; i < 3; ++i) {
    size = std::max(size, std::abs(a.translation[i]));
    difference = std::max(difference, std::abs(a.translation[i] - b.translation[i]));
  }
  return difference <= kTolerance * size;
}

}  // namespace

Json poses_to_json(const std::vector<View>& given, const std::vector<View>& refined, const CoordinateFrame& frame) {
  B3DGS_CHECK(given.size() == refined.size(), given.size(), " given views, ", refined.size(), " refined ones");
  Json poses = Json::array();
  for (std::size_t i = 0; i < given.size(); ++i) {
    const Camera before = change_frame(frame, {}, given[i].camera), after = change_frame(frame, {}, refined[i].camera);
    const Pose &from = before.cam_from_world, &to = after.cam_from_world;
    poses.push_back({{"img_name", given[i].name},
                     {"qvec", quaternion_from_rotation(to.rotation)},
                     {"tvec", to.translation},
                     {"given_qvec", quaternion_from_rotation(from.rotation)},
                     {"given_tvec", from.translation},
                     {"turned_degrees", angle_between(from, to)},
                     {"moved", distance_between(before, after)}});
  }
  return poses;
}

void apply_refined_poses(const std::filesystem::path& path, std::vector<View>& views, const CoordinateFrame& frame) {
  std::ifstream file(path);
  if (!file) input_error(path.string(), ": cannot be opened (expected the poses.json of a model folder)");
  const Json json = parse_json(file);
  if (!json.is_array()) input_error(path.string(), ": expected a JSON list of poses, as b3dgs train writes it");
  std::map<std::string, View*> by_name;
  for (View& view : views) by_name[view.name] = &view;
  for (std::size_t i = 0; i < json.size(); ++i) {
    const std::string place = path.string() + ": pose " + std::to_string(i);
    try {
      const auto found = by_name.find(json[i].at("img_name").get<std::string>());
      const Pose given = pose_from_json(json[i], "given_", place), refined = pose_from_json(json[i], "", place);
      if (found == by_name.end()) continue;
      Camera& camera = found->second->camera;
      Camera world = change_frame(frame, {}, camera);
      if (!is_same(world.cam_from_world, given)) continue;
      world.cam_from_world = refined;
      camera = change_frame({}, frame, world);
    } catch (const Json::exception&) {
      input_error(place, ": expected img_name, qvec[4], tvec[3], given_qvec[4] and given_tvec[3]");
    }
  }
}

}  // namespace b3dgs
