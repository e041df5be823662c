#include "model/cameras/cameras_json.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "core/files/json_file.h"
#include "core/json_text.h"
#include "core/vec.h"
#include "scene/cameras/camera.h"
#include "scene/cameras/camera_lens.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image_folder.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json camera_to_json(std::size_t id, const View& view, const CoordinateFrame& frame) {
  const Camera camera = change_frame(frame, {}, view.camera);
  const std::array<double, 9>& r = camera.cam_from_world.rotation;
  Json json{{"id", id},
            {"img_name", view.name},
            {"width", camera.width},
            {"height", camera.height},
            {"position", camera.center()},
            {"rotation", {{r[0], r[3], r[6]}, {r[1], r[4], r[7]}, {r[2], r[5], r[8]}}},  // camera to world
            {"fy", camera.fy},
            {"fx", camera.fx},
            {"cx", camera.cx},
            {"cy", camera.cy}};
  if (!camera.is_pinhole()) {
    const ColmapCamera named = to_colmap_camera(camera);
    json["params"] = named.params;
    json["camera_model"] = camera_model_name(named.model);
  }
  return json;
}

/// Returns the lens of an entry, with the focal lengths and the principal point of `camera`.
LensParams<double> lens_from_json(const Json& entry, const Camera& camera, const std::string& place) {
  if (!entry.contains("camera_model")) return {};
  ColmapCamera named;
  named.width = static_cast<std::uint64_t>(camera.width);
  named.height = static_cast<std::uint64_t>(camera.height);
  named.model = camera_model_from_name(entry["camera_model"].get<std::string>(), place);
  named.params = entry.at("params").get<std::vector<double>>();
  if (named.params.size() != static_cast<std::size_t>(camera_model_param_count(named.model))) {
    input_error(place, ": expected the parameters ", camera_model_params(named.model), ", found ", named.params.size(),
                " numbers");
  }
  for (const double value : named.params) {
    if (!(std::abs(value) <= kMaxCoordinate)) input_error(place, ": expected finite params, found ", value);
  }
  // A panorama may have any size, because a reduced one need not be twice as wide as high.
  if (named.model == CameraModel::kEquirectangular) {
    return panorama_camera({camera.width, camera.height}).lens;
  }
  return native_camera(camera_of(named, place), place).lens;
}

/// @throws nlohmann::json::exception for missing keys and wrong types; InputError for sizes out of range
NamedCamera camera_from_json(const Json& entry, const std::string& place) {
  NamedCamera named;
  named.name = entry.at("img_name").get<std::string>();
  if (detail::has_control_characters(named.name))
    input_error(place, ": img_name has control characters; rename the image");
  Camera& camera = named.camera;
  camera.width = json_integer<int>(entry.at("width"), "width", place, 1, kMaxImageSide);
  camera.height = json_integer<int>(entry.at("height"), "height", place, 1, kMaxImageSide);
  entry.at("fx").get_to(camera.fx);
  entry.at("fy").get_to(camera.fy);
  camera.cx = entry.value("cx", 0.5 * camera.width);
  camera.cy = entry.value("cy", 0.5 * camera.height);
  named.held_out = entry.value("held_out", false);
  camera.lens = lens_from_json(entry, camera, place);
  const auto position = entry.at("position").get<std::array<double, 3>>();
  const auto world_from_cam = entry.at("rotation").get<std::array<std::array<double, 3>, 3>>();
  Pose& pose = camera.cam_from_world;
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column < 3; ++column) {
      pose.rotation[3 * row + column] = world_from_cam[column][row];
      pose.translation[row] -= world_from_cam[column][row] * position[column];
    }
  }
  return named;
}

/// Returns the angle between two orientations, degrees. Uses the sine of half the angle, because the cosine of a small
/// angle is about 1.
double angle_between(const Pose& a, const Pose& b) {
  double square = 0;  // squared difference of the matrices: 8 sin^2(angle / 2)
  for (std::size_t i = 0; i < 9; ++i) square += (a.rotation[i] - b.rotation[i]) * (a.rotation[i] - b.rotation[i]);
  return 2 * std::asin(std::min(1.0, std::sqrt(square / 8))) * 180 / kPi;
}

Pose pose_from_json(const Json& entry, const std::string& prefix, const std::string& place) {
  const auto qvec = entry.at(prefix + "qvec").get<std::array<double, 4>>();
  const double square = qvec[0] * qvec[0] + qvec[1] * qvec[1] + qvec[2] * qvec[2] + qvec[3] * qvec[3];
  if (!(std::abs(square - 1) < 1e-3)) input_error(place, ": expected a unit quaternion as ", prefix, "qvec");
  return {rotation_from_quaternion(qvec), entry.at(prefix + "tvec").get<std::array<double, 3>>()};
}

/// `what` is the file's name in a model folder.
Json read_part(const fs::path& path, const char* what) {
  if (!fs::exists(path)) input_error(path.string(), ": cannot be opened (expected the ", what, " of a model folder)");
  return read_json(path);
}

/// Returns whether the poses are equal up to rounding.
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

std::string camera_fault(const Camera& camera) {
  if (!(camera.fx > 0) || !(camera.fy > 0)) return "expected focal lengths above 0";
  for (const double value : {camera.fx, camera.fy, 1 / camera.fx, 1 / camera.fy, camera.cx, camera.cy}) {
    if (!(std::abs(value) <= kMaxCoordinate)) return "impossible focal length or principal point";
  }
  for (const double value : camera.cam_from_world.translation) {
    if (!(std::abs(value) <= kMaxCoordinate)) return "impossible position, expected coordinates of at most 1e+12";
  }
  const std::array<double, 9>& r = camera.cam_from_world.rotation;
  for (std::size_t row = 0; row < 9; row += 3) {
    const double squared = r[row] * r[row] + r[row + 1] * r[row + 1] + r[row + 2] * r[row + 2];
    if (!(std::abs(squared - 1) < 1e-3)) return "expected an orthonormal rotation matrix";
  }
  return "";
}

nlohmann::ordered_json cameras_to_json(const std::vector<View>& test, const std::vector<View>& train,
                                       const CoordinateFrame& frame) {
  Json cameras = Json::array();
  for (const std::vector<View>* views : {&test, &train}) {
    for (const View& view : *views) {
      cameras.push_back(camera_to_json(cameras.size(), view, frame));
      if (views == &test) cameras.back()["held_out"] = true;
    }
  }
  return cameras;
}

std::vector<NamedCamera> cameras_from_json(const Json& json, const std::string& file) {
  if (!json.is_array() || json.empty()) {
    input_error(file, ": expected a JSON list of cameras, as b3dgs train writes it");
  }
  std::vector<NamedCamera> cameras;
  for (const Json& entry : json) {
    const std::string place = file + ": camera " + std::to_string(cameras.size());
    try {
      cameras.push_back(camera_from_json(entry, place));
    } catch (const Json::exception&) {
      input_error(place, ": expected img_name, width, height, position[3], rotation[3][3], fx and fy, and params with ",
                  "camera_model");
    }
    if (const std::string fault = camera_fault(cameras.back().camera); !fault.empty()) {
      input_error(place, " (", cameras.back().name, "): ", fault);
    }
  }
  return cameras;
}

std::vector<NamedCamera> read_cameras_json(const std::filesystem::path& path) {
  return cameras_from_json(read_part(path, "cameras.json"), path.string());
}

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
                     {"moved", distance(after.center(), before.center())}});
  }
  return poses;
}

void apply_refined_poses(const std::filesystem::path& path, std::vector<View>& views, const CoordinateFrame& frame) {
  const Json json = read_part(path, "poses.json");
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

namespace {

constexpr double kMaxFps = 1000;
constexpr const char* kExpected = "expected a cameras.json, a nerfstudio camera path or a transforms.json";

void check_camera(const Camera& camera, const std::string& place) {
  if (const std::string fault = camera_fault(camera); !fault.empty()) input_error(place, ": ", fault);
}

CameraFile read_camera_path(const Json& json, const std::string& file, ImageSize size) {
  const JsonValues values(json, json, file);
  if (const std::string type = values.text("camera_type"); !type.empty() && type != "perspective") {
    input_error(file, ": camera_type: expected \"perspective\", found \"", type.substr(0, 80),
                "\"; only pinhole cameras can be rendered");
  }
  const std::optional<int> width = values.side("render_width"), height = values.side("render_height");
  if (width && height) size = {*width, *height};
  if (size.width <= 0 || size.height <= 0) {
    input_error(file, ": has no render_width and render_height; name a size with --width and --height");
  }
  const Json& frames = json.at("camera_path");
  if (!frames.is_array() || frames.empty()) {
    input_error(file, ": expected at least one frame in \"camera_path\", found ", json_excerpt(frames));
  }
  CameraFile result;
  for (const Json& frame : frames) {
    const std::string place = file + ": frame " + std::to_string(result.cameras.size());
    if (!frame.is_object()) input_error(place, ": expected an object, found ", json_excerpt(frame));
    const JsonValues own(frame, frame, place);
    const std::optional<double> fov = own.positive("fov", 179.9);
    if (!fov) input_error(place, ": expected camera_to_world and fov, found no fov");
    const Pose pose = pose_from_opengl(own.matrix("camera_to_world"), place);
    result.cameras.push_back({"", Camera::with_field_of_view(size.width, size.height, *fov, pose)});
    check_camera(result.cameras.back().camera, place);
  }
  if (const auto fps = values.positive("fps", kMaxFps)) {
    result.fps = *fps;
  } else if (const auto seconds = values.positive("seconds", 1e6)) {
    result.fps = std::clamp(static_cast<double>(result.cameras.size()) / *seconds, 1e-3, kMaxFps);
  }
  return result;
}

CameraFile read_transforms_cameras(const std::string& text, const fs::path& path, ImageSize size) {
  TransformsModel frames;
  const auto sizes_of = [&](const std::string& name) -> PhotographSizes {
    if (is_file(frames.files.at(name))) return {read_image_size(frames.files.at(name))};
    if (size.width > 0 && size.height > 0) return {size};
    input_error(path.string(), ": frame ", frames.model.images.size(), " (", name,
                "): has no size (w, h), and no photograph; name a size with --width and --height");
  };
  read_transforms(text, path, sizes_of, frames);
  if (!frames.model.left_out.empty()) input_error(frames.model.left_out.front().reason);
  CameraFile result;
  for (const ColmapImage& image : frames.model.images) {
    const std::string& place = frames.camera_places.at(image.camera_id);
    Camera camera = camera_of(frames.model.cameras.at(image.camera_id), place);
    if (camera.lens.kind != LensKind::kEquirectangular) camera = camera.without_lens();
    camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
    check_camera(camera, place);
    result.cameras.push_back({image.name, camera});
  }
  return result;
}

}  // namespace

CameraFile read_camera_file(const fs::path& path, ImageSize size) {
  std::error_code error;
  if (!fs::exists(path, error)) input_error("camera file not found: ", path.string(), " (", kExpected, ")");
  return parse_camera_file(read_whole_file(path), path, size);
}

CameraFile parse_camera_file(const std::string& text, const fs::path& path, ImageSize size) {
  const Json json = parse_json_with_extras(text, path.string());
  if (json.is_array()) return {cameras_from_json(json, path.string()), 0};
  if (json.is_object() && json.contains("camera_path")) return read_camera_path(json, path.string(), size);
  if (json.is_object() && json.contains("frames")) return read_transforms_cameras(text, path, size);
  input_error(path.string(),
              ": unknown kind of camera file (expected a list of cameras, \"camera_path\" or \"frames\")",
              json.is_object() && json.contains("keyframes") ? "; it has keyframes only: export the path again" : "");
}

}  // namespace b3dgs
