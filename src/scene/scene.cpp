#include "scene/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>
#include <tuple>

#include "core/check.h"
#include "core/host_memory.h"
#include "scene/colmap/model_search.h"
#include "scene/images/image_folder.h"
#include "scene/images/resolution.h"
#include "scene/scene_summary.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

// Registered images by name; the files and the split go by it.
std::vector<const ColmapImage*> sorted_by_name(const ColmapModel& model) {
  std::vector<const ColmapImage*> images;
  for (const ColmapImage& image : model.images) images.push_back(&image);
  std::sort(images.begin(), images.end(), [](const ColmapImage* a, const ColmapImage* b) { return a->name < b->name; });
  return images;
}

// The files of the registered images by name; images that are not on disk have none.
std::map<std::string, fs::path> find_files(const ColmapModel& model, const ImageFolder& folder) {
  std::map<std::string, fs::path> files;
  std::map<fs::path, std::string> names;
  for (const ColmapImage& image : model.images) {
    const fs::path file = folder.find(image.name);
    if (file.empty()) continue;
    files[image.name] = file;
    names[file] = image.name;
  }
  for (const ColmapImage& image : model.images) {
    if (files.count(image.name)) continue;
    const fs::path file = folder.find_similar(image.name);
    if (file.empty()) continue;
    const auto other = names.find(file);
    if (other == names.end()) {
      files[image.name] = file;
      names[file] = image.name;
    } else if (folder.find(other->second).empty()) {  // both only similar: one of them would get a wrong photograph
      input_error(file.string(), ": the registered images ", other->second, " and ", image.name,
                  " both lead to this file; keep their sub-folders in the image folder");
    }
  }
  return files;
}

ViewSource view_source(const ColmapImage& image, const ColmapCamera& camera, const fs::path& model_folder,
                       const fs::path& file, int divisor, int resolution) {
  ViewSource source;
  source.name = image.name;
  source.file = file;
  source.camera_id = camera.id;
  source.camera_place = detail::concat(model_folder.string(), ": camera ", camera.id);
  source.file_size = read_image_size(file);
  source.size = training_size(divided_size(source.file_size, divisor), resolution);
  source.lens = lens_of(camera, source.camera_place)
                    .scaled(source.file_size.width / static_cast<double>(camera.width),
                            source.file_size.height / static_cast<double>(camera.height));
  return source;
}

View view_of(const ColmapImage& image, const ViewSource& source) {
  View view;
  view.name = image.name;
  Camera camera;
  camera.width = source.file_size.width;
  camera.height = source.file_size.height;
  camera.fx = source.lens.fx;
  camera.fy = source.lens.fy;
  camera.cx = source.lens.cx;
  camera.cy = source.lens.cy;
  camera.cam_from_world.rotation = rotation_from_quaternion(image.quat);
  camera.cam_from_world.translation = image.translation;
  view.camera = camera.scaled_to(source.size.width, source.size.height);
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

// Gives distorted sources their lens groups. Returns each view's mask, reduced to its size and shared by its group;
// null: all valid.
std::vector<std::shared_ptr<const Image8>> add_lens_groups(std::vector<ViewSource>& sources, UndistorterCache& cache) {
  using Key = std::tuple<std::uint32_t, int, int>;  // camera, width and height of the file
  struct Group {
    int number;
    std::shared_ptr<const Image8> valid;
  };
  std::map<Key, Group> groups;
  std::vector<std::shared_ptr<const Image8>> masks(sources.size());
  for (std::size_t i = 0; i < sources.size(); ++i) {
    ViewSource& source = sources[i];
    if (source.lens.is_pinhole()) continue;
    const Key key{source.camera_id, source.file_size.width, source.file_size.height};
    auto found = groups.find(key);
    if (found == groups.end()) {
      const int number = cache.add_group(source.lens, source.file_size, source.camera_place);
      std::shared_ptr<const Image8> valid = cache.get(number)->valid();
      if (valid) valid = std::make_shared<Image8>(shrink_mask(*valid, source.size.width, source.size.height));
      found = groups.emplace(key, Group{number, std::move(valid)}).first;
    }
    source.lens_group = found->second.number;
    masks[i] = found->second.valid;
  }
  return masks;
}

// Gives the views their images and masks. No image is decoded.
void add_images(std::vector<View>& views, std::vector<ViewSource>& sources, const SceneOptions& options) {
  constexpr std::int64_t kMapShare = 8;  // one part in so many is for the maps of undistorters
  ImageMemory::Plan plan;
  plan.limit = image_memory_limit(options.host_memory_gb, available_host_memory());
  plan.n_readers = options.n_readers;
  const auto undistorters = std::make_shared<UndistorterCache>(plan.limit / kMapShare);
  const std::vector<std::shared_ptr<const Image8>> masks = add_lens_groups(sources, *undistorters);
  plan.fixed = undistorters->most_kept_bytes();
  std::set<const Image8*> different_masks;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::int64_t bytes = std::int64_t{3} * sources[i].size.width * sources[i].size.height;
    plan.photographs += bytes;
    plan.largest = std::max(plan.largest, bytes);
    if (masks[i] && different_masks.insert(masks[i].get()).second) {
      plan.fixed += static_cast<std::int64_t>(masks[i]->pixels.size());
    }
  }
  const auto shared = std::make_shared<SceneImages>(plan, undistorters, options.white_background);
  for (std::size_t i = 0; i < views.size(); ++i) {
    views[i].image = std::make_shared<ViewImage>(sources[i], shared);
    views[i].valid = masks[i];
  }
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
  const ColmapModel model = read_colmap_model(model_folder.folder);
  const ImageFolder folder(source_path, options.images);

  std::vector<View> views;
  std::vector<ViewSource> sources;
  std::vector<std::string> missing;
  const std::map<std::string, fs::path> files = find_files(model, folder);
  for (const ColmapImage* image : sorted_by_name(model)) {
    const auto file = files.find(image->name);
    if (file == files.end()) {
      missing.push_back(image->name);
      continue;
    }
    sources.push_back(view_source(*image, model.cameras.at(image->camera_id), model_folder.folder, file->second,
                                  folder.divisor(), options.resolution));
    views.push_back(view_of(*image, sources.back()));
    if (progress) progress("reading image headers", views.size(), files.size());
    views.back().file = file->second.string();
  }
  if (views.empty()) {
    input_error((source_path / options.images).string(), ": ",
                missing.empty() ? "the model has no registered images; reconstruct the scene again"
                                : detail::concat("none of the ", missing.size(), " registered images is there (first: ",
                                                 missing.front(), "); put them there or name their folder with -i"));
  }
  if (options.load_images) add_images(views, sources, options);

  Scene scene;
  scene.source_path = options.source_path;
  scene.points = points_of(model);
  for (std::size_t i = 0; i < views.size(); ++i) {
    std::vector<View>& part = options.eval && i % kTestEvery == 0 ? scene.test : scene.train;
    part.push_back(std::move(views[i]));
  }
  if (scene.train.empty()) {
    input_error(options.source_path, ": holding out every ", kTestEvery, "th image leaves none of ", scene.test.size(),
                " to train on; leave out --eval");
  }
  scene.extent = scene_extent(scene.train);
  if (!missing.empty()) {
    scene.warnings.push_back(detail::concat("registered images missing in ", folder.folder().string(), ": ",
                                            missing.size(), " of ", model.images.size(), " (first: ", missing.front(),
                                            "); training and measures go without them"));
  }
  std::set<fs::path> used;
  for (const ViewSource& source : sources) used.insert(source.file);
  scene.summary = summarize(scene, {options, model_folder, model, folder, sources, missing, folder.count_others(used)});
  return scene;
}

std::string scene_name(const std::string& source_path) {
  const std::filesystem::path scene = std::filesystem::absolute(source_path).lexically_normal();
  return (scene.has_filename() ? scene : scene.parent_path()).filename().string();
}

}  // namespace b3dgs
