#include "app/render/camera_choice.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "app/render/camera_path.h"
#include "core/check.h"
#include "core/text.h"
#include "scene/cameras/camera_lens.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr ImageSize kDefaultSize{1280, 720};
constexpr double kDefaultElevation = 15, kDefaultFisheyeFov = 180, kMaxPinholeFov = 170;  // degrees

bool goes_around(const CameraOptions& options) {
  return options.path == "orbit" || options.path == "turntable";
}

/// Returns whether the cameras move through others or around something.
bool is_path(const CameraOptions& options) {
  return goes_around(options) || options.path == "interpolated";
}

/// Returns the views that a path goes through or around, or that are rendered themselves.
CameraChoice key_cameras(const CommandLine& line, const CameraOptions& options, const Scene& scene,
                         const CoordinateFrame& frame) {
  CameraChoice keys;
  if (!options.cameras.empty()) {
    CameraFile file = read_camera_file(options.cameras, {options.width, options.height});
    const bool has_names = std::all_of(file.cameras.begin(), file.cameras.end(),
                                       [](const NamedCamera& named) { return !named.name.empty(); });
    for (NamedCamera& named : file.cameras) {
      named.camera = change_frame({}, frame, named.camera);
      keys.cameras.push_back(named.camera);
      if (has_names) keys.views.push_back({named.name, "", named.camera, nullptr, nullptr});
    }
    keys.set = "cameras/" + fs::path(options.cameras).stem().string();
    keys.fps = file.fps;
    return keys;
  }
  // Without test views, as for a file of Gaussians, the default is the training views.
  const bool is_test = options.path == "test" && (line.was_given("path") || !scene.test.empty());
  keys.set = is_test ? "test" : "train";
  keys.views = is_test ? scene.test : scene.train;
  for (const View& view : keys.views) keys.cameras.push_back(view.camera);
  if (keys.cameras.empty() && !goes_around(options)) {
    input_error("no views for --path ", options.path,
                " (the model was trained without --eval); use --path train or interpolated");
  }
  return keys;
}

ImageSize wanted_size(const CameraOptions& options, ImageSize size) {
  if (options.width > 0 && options.height > 0) return {options.width, options.height};
  const double aspect = static_cast<double>(size.width) / size.height;
  const auto side = [](double value) {
    return static_cast<int>(std::clamp(std::round(value), 1.0, double{kMaxRenderSide}));
  };
  if (options.width > 0) return {options.width, side(options.width / aspect)};
  if (options.height > 0) return {side(options.height * aspect), options.height};
  return size;
}

/// Returns the camera for an image of another size, with its focal lengths times `scale`.
Camera fit(const Camera& camera, ImageSize size, double scale) {
  if (size == ImageSize{camera.width, camera.height}) return camera;
  Camera fitted = camera;
  fitted.width = size.width;
  fitted.height = size.height;
  fitted.fx *= scale;
  fitted.fy *= scale;
  fitted.cx = 0.5 * size.width + scale * (camera.cx - 0.5 * camera.width);
  fitted.cy = 0.5 * size.height + scale * (camera.cy - 0.5 * camera.height);
  return fitted;
}

/// Returns the camera in the size given by the options.
Camera in_wanted_size(const CameraOptions& options, const Camera& camera) {
  const bool has_path_size = options.path_size.width > 0 && options.width == 0 && options.height == 0;
  return has_path_size && is_path(options) ? fit_longer_side(camera, options.path_size)
                                           : fit_to_size(camera, wanted_size(options, {camera.width, camera.height}));
}

/// Returns image size and focal lengths of the cameras on an orbit.
Camera orbit_lens(const CameraOptions& options, const std::vector<Camera>& keys) {
  const bool has_fov = options.fov > 0 && options.projection != "fisheye";
  const double fov = has_fov ? options.fov : Camera::kDefaultFov;
  if (keys.empty()) {
    const ImageSize size = wanted_size(options, options.path_size.width > 0 ? options.path_size : kDefaultSize);
    return Camera::with_field_of_view(size.width, size.height, fov, {});
  }
  Camera lens = in_wanted_size(options, keys[0]);
  if (has_fov) {
    const double pixel_aspect = lens.fx / lens.fy;
    lens.fy = 0.5 * lens.height / std::tan(0.5 * fov * kDegree);
    lens.fx = pixel_aspect * lens.fy;
  }
  return lens;
}

cv::Vec3d up_axis(const std::string& name, const std::vector<Camera>& keys) {
  if (name == "auto") return cv::Vec3d(up_direction(keys).value_or(std::array<double, 3>{0, -1, 0}).data());
  const double sign = name[0] == '-' ? -1 : 1;
  const char axis = name.back();
  return {axis == 'x' ? sign : 0, axis == 'y' ? sign : 0, axis == 'z' ? sign : 0};
}

/// Formats "(1.5, 0, -2.25)", rounded to 0.01.
std::string vec_text(const cv::Vec3d& v) {
  const auto rounded = [](double value) { return std::round(100 * value) / 100 + 0.0; };  // not -0
  return print_to_string("(%.10g, %.10g, %.10g)", rounded(v[0]), rounded(v[1]), rounded(v[2]));
}

/// Returns the distance at which a ball of the Gaussians' size fits into the image.
double fitting_distance(const SplatBounds& bounds, const Camera& lens) {
  constexpr double kBall = 1.4;  // the median distance is 0.8 of the radius of a full ball, and 0.7 of that of a disc
  const double half_angle = std::atan(0.5 * std::min(lens.width / lens.fx, lens.height / lens.fy));
  return kBall * bounds.radius / std::sin(half_angle);
}

Orbit choose_orbit(const CommandLine& line, const CameraOptions& options, const std::vector<Camera>& all,
                   const SplatCloud& splats, const Camera& lens) {
  const std::vector<Camera> keys = usual_cameras(all, {});
  const SplatBounds bounds = splat_bounds(splats);
  const cv::Vec3d up = up_axis(options.up, keys);
  const cv::Vec3d focus = focus_of(keys, bounds.center);
  if (options.path == "orbit" && !keys.empty()) return orbit_through(keys, focus, up);
  CameraPlacement placement{fitting_distance(bounds, lens), kDefaultElevation * kDegree};
  cv::Vec3d toward = focus + cv::Vec3d{0, 0, -1};
  if (!keys.empty()) {
    placement = placement_of(keys, focus, up);
    toward = cv::Vec3d(keys[0].center().data());
  }
  if (options.distance > 0) placement.distance = options.distance / splats.frame.unit;
  if (line.was_given("elevation")) placement.elevation = options.elevation * kDegree;
  placement.elevation = std::clamp(placement.elevation, -89 * kDegree, 89 * kDegree);
  return turntable(focus, up, placement.distance, placement.elevation, toward);
}

/// Returns a camera of the same pose in the projection given by the options.
Camera in_projection(const CameraOptions& options, const Camera& camera) {
  if (options.projection == "auto") return camera;
  if (options.projection == "pinhole") return camera.without_lens();
  Camera projected;
  if (options.projection == "equirectangular") {
    if (options.width > 0 && options.height > 0 && options.width != 2 * options.height) {
      input_error("--projection equirectangular: expected images twice as wide as high, found --width ", options.width,
                  " and --height ", options.height, "; name only one of them");
    }
    projected = panorama_camera(options.width > 0 ? ImageSize{camera.width, std::max(1, camera.width / 2)}
                                                  : ImageSize{2 * camera.height, camera.height});
  } else {
    const double focal = camera.height / ((options.fov > 0 ? options.fov : kDefaultFisheyeFov) * kDegree);
    projected = {camera.width, camera.height, focal, focal, 0.5 * camera.width, 0.5 * camera.height, {}, {}};
    projected.lens.kind = LensKind::kFisheye;
    projected = native_camera(projected, "--projection " + options.projection);
  }
  projected.cam_from_world = camera.cam_from_world;
  return projected;
}

CameraChoice choose_places(const CommandLine& line, const CameraOptions& options, const Scene& scene,
                           const SplatCloud& splats) {
  CameraChoice choice = key_cameras(line, options, scene, splats.frame);
  if (is_path(options)) {
    choice.set = options.cameras.empty() ? options.path : choice.set + "_" + options.path;
    choice.views.clear();
    for (Camera& key : choice.cameras) key = key.without_lens();
  }
  if (!goes_around(options)) {
    for (Camera& camera : choice.cameras) camera = in_wanted_size(options, camera);
    if (is_path(options)) choice.cameras = interpolate_cameras(choice.cameras, options.frames);
    return choice;
  }
  const std::vector<Camera> keys = std::move(choice.cameras);
  const Camera lens = orbit_lens(options, keys);
  const Orbit orbit = choose_orbit(line, options, keys, splats, lens);
  choice.cameras = cameras_on(orbit, lens, options.frames);
  const std::array<double, 3> world = splats.frame.to_world(orbit.focus.val);
  const double distance = splats.frame.unit * std::hypot(orbit.first_radius, orbit.height);
  choice.notes.push_back("around " + vec_text(cv::Vec3d(world.data())) + ", up " + vec_text(orbit.up) +
                         print_to_string(", distance %.3g", distance));
  if (keys.empty()) return choice;
  const Coverage coverage = coverage_of(keys, orbit.focus, orbit.up, orbit.first_axis);
  if (orbit.swing > 0) {
    choice.notes.push_back(print_to_string("along an arc of %.0f degrees and back: the cameras do not go all around",
                                           2 * orbit.swing / kDegree));
  } else if (coverage.gap > kFullCircleGap) {
    choice.notes.push_back(
        print_to_string("the cameras leave a gap of %.0f degrees around this point; expect blur and holes there",
                        coverage.gap / kDegree));
  }
  return choice;
}

}  // namespace

bool needs_views(const CameraOptions& options) {
  return options.cameras.empty() && !goes_around(options);
}

void check_camera_options(const CommandLine& line, const CameraOptions& options) {
  const bool around = goes_around(options), is_fisheye = options.projection == "fisheye";
  if (!options.cameras.empty() && line.was_given("path") && !is_path(options)) {
    input_error("--cameras replaces --path ", options.path, "; use one of them");
  }
  const auto allow = [&](const char* option, bool is_used, const char* use) {
    if (line.was_given(option) && !is_used) input_error("--", option, " is for ", use);
  };
  if (line.was_given("resolution") && !options.cameras.empty()) {
    input_error("-r is for the views of a scene; use --width and --height with --cameras");
  }
  allow("frames", is_path(options),
        "--path interpolated, orbit and turntable; the others have one image for each view");
  allow("fov", around || is_fisheye, "--path orbit and turntable and --projection fisheye");
  allow("up", around, "--path orbit and turntable");
  for (const char* name : {"elevation", "distance"}) allow(name, options.path == "turntable", "--path turntable");
  if (options.fov > kMaxPinholeFov && !is_fisheye) {
    input_error("--fov ", options.fov, ": a pinhole shows at most ", kMaxPinholeFov,
                " degrees; use --projection fisheye");
  }
}

CameraChoice choose_cameras(const CommandLine& line, const CameraOptions& options, const Scene& scene,
                            const SplatCloud& splats) {
  CameraChoice choice = choose_places(line, options, scene, splats);
  for (Camera& camera : choice.cameras) camera = in_projection(options, camera);
  return choice;
}

Camera fit_to_size(const Camera& camera, ImageSize size) {
  return fit(camera, size, static_cast<double>(size.height) / camera.height);
}

Camera fit_longer_side(const Camera& camera, ImageSize size) {
  return fit(camera, size,
             static_cast<double>(std::max(size.width, size.height)) / std::max(camera.width, camera.height));
}

}  // namespace b3dgs
