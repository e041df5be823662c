#include "scene/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "core/check.h"
#include "scene/colmap/colmap.h"
#include "scene/colmap/model_search.h"
#include "scene/images/image_folder.h"
#include "scene/images/image_io.h"
#include "scene/images/resolution.h"
#include "scene/scene_images.h"
#include "scene/scene_summary.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::map<std::string, fs::path> find_photographs(const ColmapModel& model, const ImageFolder& folder) {
  std::vector<std::string> names;
  for (const ColmapImage& image : model.images) names.push_back(image.name);
  return folder.find_all(names);
}

// The order of the views, and so of the split.
std::vector<const ColmapImage*> sorted_by_name(const ColmapModel& model) {
  std::vector<const ColmapImage*> images;
  for (const ColmapImage& image : model.images) images.push_back(&image);
  std::sort(images.begin(), images.end(), [](const ColmapImage* a, const ColmapImage* b) { return a->name < b->name; });
  return images;
}

// Reads the photograph's header. Photographs may be smaller or larger than COLMAP's camera.
ViewSource view_source(const ColmapImage& image, const ColmapCamera& camera, const fs::path& model_folder,
                       const fs::path& file, int divisor, int resolution) {
  ViewSource source;
  source.name = image.name;
  source.image_id = image.id;
  source.file = file;
  source.camera_id = camera.id;
  source.camera_place = detail::concat(model_folder.string(), ": camera ", camera.id);
  source.file_size = read_image_size(file);
  source.size = training_size(divided_size(source.file_size, divisor), resolution);
  source.lens = lens_of(camera, source.camera_place)
                    .scaled(source.file_size.width / static_cast<double>(camera.width),
                            source.file_size.height / static_cast<double>(camera.height));
  source.camera = source.lens.pinhole(source.file_size).scaled_to(source.size.width, source.size.height);
  source.camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
  return source;
}

View view_of(const ViewSource& source, const std::shared_ptr<SceneImages>& images) {
  View view;
  view.name = source.name;
  view.file = source.file.string();
  view.camera = source.camera;
  if (images) view.image = std::make_shared<ViewImage>(source, images);
  view.valid = source.valid;
  return view;
}

PointCloud points_of(const ColmapModel& model) {
  PointCloud points;
  points.positions.reserve(3 * model.points.size());
  points.colors.reserve(3 * model.points.size());
  for (const ColmapPoint& point : model.points) {
    for (const double value : point.position) points.positions.push_back(static_cast<float>(value));
    points.colors.insert(points.colors.end(), point.color.begin(), point.color.end());
  }
  return points;
}

/// Rows of the points in each image's tracks, by its ID, ascending.
std::map<std::uint32_t, std::vector<std::int32_t>> visible_points(const ColmapModel& model) {
  std::map<std::uint32_t, std::vector<std::int32_t>> points;
  for (std::size_t row = 0; row < model.points.size(); ++row) {
    for (const std::uint32_t image : model.points[row].image_ids) {
      std::vector<std::int32_t>& own = points[image];
      // Two keypoints of an image may belong to one point.
      if (own.empty() || own.back() != static_cast<std::int32_t>(row)) own.push_back(static_cast<std::int32_t>(row));
    }
  }
  return points;
}

}  // namespace

double scene_extent(const std::vector<View>& views) {
  std::vector<std::array<double, 3>> centers;
  std::array<double, 3> mean{};
  for (const View& view : views) {
    centers.push_back(view.camera.center());
    for (int i = 0; i < 3; ++i) mean[i] += centers.back()[i] / static_cast<double>(views.size());
  }
  double largest = 0;
  for (const std::array<double, 3>& center : centers) {
    largest = std::max(largest, std::hypot(center[0] - mean[0], center[1] - mean[1], center[2] - mean[2]));
  }
  return largest > 0 ? 1.1 * largest : 1.0;
}

Scene load_scene(const SceneOptions& options, const ProgressFn& progress) {
  check_resolution(options.resolution);
  const fs::path source_path = options.source_path;
  const SparseModelFolder model_folder = find_model_folder(source_path);
  const ColmapModel model = read_colmap_model(model_folder.folder, options.tracks);
  const ImageFolder folder(source_path, options.images);

  const std::map<std::string, fs::path> files = find_photographs(model, folder);
  std::vector<ViewSource> sources;
  std::vector<std::string> missing;
  for (const ColmapImage* image : sorted_by_name(model)) {
    const auto file = files.find(image->name);
    if (file == files.end()) {
      missing.push_back(image->name);
      continue;
    }
    sources.push_back(view_source(*image, model.cameras.at(image->camera_id), model_folder.folder, file->second,
                                  folder.divisor(), options.resolution));
    if (progress) progress("reading image headers", sources.size(), files.size());
  }
  if (sources.empty()) {
    input_error((source_path / options.images).string(), ": ",
                missing.empty() ? "the model has no registered images; reconstruct the scene again"
                                : detail::concat("none of the ", missing.size(), " registered images found (first: ",
                                                 missing.front(), "); copy them there or choose their folder with -i"));
  }
  const std::shared_ptr<SceneImages> images = options.load_images ? prepare_images(sources, options) : nullptr;

  Scene scene;
  scene.source_path = options.source_path;
  scene.points = points_of(model);
  std::map<std::uint32_t, std::vector<std::int32_t>> points_of_image = visible_points(model);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    std::vector<View>& part = options.eval && i % kTestEvery == 0 ? scene.test : scene.train;
    part.push_back(view_of(sources[i], images));
    if (options.tracks) part.back().points = std::move(points_of_image[sources[i].image_id]);
  }
  if (scene.train.empty()) {
    input_error(options.source_path, ": --eval holds out every ", kTestEvery, "th image, which leaves none of ",
                scene.test.size(), " to train on; remove --eval");
  }
  scene.extent = scene_extent(scene.train);
  if (!missing.empty()) {
    scene.warnings.push_back(detail::concat(folder.folder().string(), ": ", missing.size(), " of ", model.images.size(),
                                            " registered images not found (first: ", missing.front(),
                                            "); training and evaluation leave them out"));
  }
  std::set<fs::path> used;
  for (const ViewSource& source : sources) used.insert(source.file);
  scene.summary = summarize(scene, {options, model_folder, model, folder, sources, missing, folder.count_others(used)});
  return scene;
}

std::string scene_name(const std::string& source_path) {
  const fs::path scene = fs::absolute(source_path).lexically_normal();
  return (scene.has_filename() ? scene : scene.parent_path()).filename().string();
}

}  // namespace b3dgs
