#include "train/scene_limits.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/json_text.h"
#include "core/text.h"

namespace b3dgs {
namespace {

/// Returns the options that determine the content of a scene, by name.
nlohmann::ordered_json compared_options(const SceneOptions& options) {
  const std::filesystem::path folder = std::filesystem::absolute(options.source_path) / "";
  return {{"source_path", folder.lexically_normal().string()},
          {"images", options.images},
          {"resolution", options.resolution},
          {"lenses", options.lenses},
          {"eval", options.eval},
          {"white_background", options.white_background},
          {"masks", options.masks},
          {"invert_masks", options.invert_masks},
          {"empty_background", options.empty_background}};
}

}  // namespace

SceneOptions scene_options(const TrainConfig& config) {
  SceneOptions options;
  options.source_path = config.source_path;
  options.images = config.images;
  options.resolution = config.resolution;
  options.eval = config.eval;
  options.white_background = config.white_background;
  options.tracks = !config.depths.empty();
  options.lenses = config.lenses;
  if (config.antialiasing && config.lenses == "auto")
    options.lenses = "undistort";  // filter sizes are known for pinholes only
  options.masks = config.masks;
  options.invert_masks = config.invert_masks;
  options.empty_background = config.mask_mode == MaskMode::kSegment;
  options.host_memory_gb = config.host_memory_gb;
  options.seed_points = config.init_ply.empty();
  return options;
}

void check_scene_options(const TrainConfig& config, const Scene& scene) {
  for (const View& view : scene.train) {
    if (!config.antialiasing || view.camera.is_pinhole()) continue;
    const bool is_panorama = view.camera.lens.kind == LensKind::kEquirectangular;
    input_error("--antialiasing: the camera of ", view.name,
                " is not a pinhole, and filter sizes are known for pinholes only; remove ", "--antialiasing",
                is_panorama ? "" : ", or undistort the photographs with --lenses undistort");
  }
  if (!scene.options || config.source_path.empty()) return;
  const nlohmann::ordered_json found = compared_options(*scene.options),
                               wanted = compared_options(scene_options(config));
  for (const auto& [name, expected] : wanted.items()) {
    if (found[name] == expected) continue;
    input_error("the scene was not read with the options of the training: ", name, " (expected ", dump_json(expected),
                " as in TrainConfig, found ", dump_json(found[name]),
                " in SceneOptions); load it with scene_options(config)");
  }
}

std::int64_t count_limit(const TrainConfig& config, const Scene& scene) {
  if (config.max_gaussians > 0 || config.gaussians_per_pixel == 0 || scene.train.empty()) return config.max_gaussians;
  double pixels = 0;
  for (const View& view : scene.train) pixels += static_cast<double>(view.camera.width) * view.camera.height;
  const auto n_views = static_cast<double>(scene.train.size());
  constexpr double kManyViews = 100;
  const double share = std::min(1.0, n_views / kManyViews);
  constexpr double kOfFew = 1.2, kOfMany = 2.4;
  double per_pixel = config.gaussians_per_pixel;
  if (share < 1) per_pixel = std::min(per_pixel, std::max(kOfFew, kOfMany * share)) * share;
  constexpr double kMost = std::numeric_limits<std::int32_t>::max() - 1;  // limit of 32-bit indices
  const double limit = std::clamp(per_pixel * pixels / n_views, 1.0, kMost);
  return std::max(static_cast<std::int64_t>(limit), static_cast<std::int64_t>(scene.points.size()));
}

int decay_start(const TrainConfig& config, const Scene& scene) {
  if (config.lr_final_scale == 1 || config.lr_decay_from_epoch == 0) return config.lr_decay_from_iter;
  const std::int64_t latest = static_cast<std::int64_t>(scene.train.size()) * config.lr_decay_from_epoch;
  return static_cast<int>(std::min<std::int64_t>(config.lr_decay_from_iter, latest));
}

Photographs training_photographs(const Scene& scene) {
  constexpr std::size_t kPoints = 5000, kViews = 500;  // about as many are sampled, at equal distances
  const auto n_points = static_cast<std::size_t>(scene.points.size());
  const std::size_t point_step = std::max<std::size_t>(1, n_points / kPoints);
  const std::size_t view_step = std::max<std::size_t>(1, scene.train.size() / kViews);
  std::vector<std::vector<std::size_t>> seen;  // points that each view sees
  std::vector<double> n_views(n_points / point_step + 1);
  for (std::size_t v = 0; v < scene.train.size(); v += view_step) {
    std::vector<std::size_t>& own = seen.emplace_back();
    for (std::size_t i = 0; i * point_step < n_points; ++i) {
      if (!scene.train[v].camera.project(&scene.points.positions[3 * i * point_step])) continue;
      own.push_back(i);
      ++n_views[i];
    }
  }
  double sum = 0, n = 0;
  for (const std::vector<std::size_t>& own : seen) {
    for (const std::size_t i : own) sum += n_views[i] / static_cast<double>(own.size());
    n += own.empty() ? 0 : 1;
  }
  if (n == 0) return scene.train.size();
  return {scene.train.size(), sum / n * static_cast<double>(view_step)};
}

TrainConfig with_scene_limits(TrainConfig config, const Scene& scene) {
  config.max_gaussians = count_limit(config, scene);
  config.lr_decay_from_iter = decay_start(config, scene);
  return config;
}

std::string near_plane_warning(const std::vector<float>& points, const std::vector<View>& views, double near_plane) {
  constexpr std::size_t kPoints = 20000, kViews = 50;  // about as many are sampled, at equal distances
  constexpr double kFewPoints = 0.05;
  const std::size_t n_points = points.size() / 3;
  const std::size_t point_step = std::max<std::size_t>(1, n_points / kPoints);
  const std::size_t view_step = std::max<std::size_t>(1, views.size() / kViews);
  std::int64_t n_seen = 0, n_near = 0;
  std::vector<double> depths;
  for (std::size_t i = 0; i < n_points; i += point_step) {
    std::int64_t n_views = 0, n_nearer = 0;
    for (std::size_t v = 0; v < views.size(); v += view_step) {
      const auto place = views[v].camera.project(&points[3 * i]);
      if (!place) continue;
      ++n_views;
      n_nearer += place->depth < near_plane ? 1 : 0;
      depths.push_back(place->depth);
    }
    n_seen += n_views > 0 ? 1 : 0;
    n_near += 2 * n_nearer > n_views ? 1 : 0;
  }
  if (n_seen == 0) {
    if (n_points == 0 || views.empty()) return "";
    return "none of the " + format_count(static_cast<std::int64_t>(n_points)) +
           " points is in front of a camera and in its image: nothing can be learned; check the poses (COLMAP: the "
           "camera looks along +z), and that the points are of the same scene";
  }
  if (static_cast<double>(n_near) <= kFewPoints * static_cast<double>(n_seen)) return "";
  const auto nearest = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 100);
  std::nth_element(depths.begin(), nearest, depths.end());
  return print_to_string(
      "%s of %s points are nearer than --near_plane %g in the views that see them, and are not rendered "
      "there; pass a smaller value, such as --near_plane %.1g",
      format_count(n_near).c_str(), format_count(n_seen).c_str(), near_plane, 0.1 * *nearest);
}

}  // namespace b3dgs
