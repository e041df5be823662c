#include "scene/scene_model.h"

#include <array>
#include <optional>

#include "core/check.h"
#include "scene/images/image.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

WorldPoints points_of(const ColmapModel& model) {
  WorldPoints points;
  points.positions.reserve(3 * model.points.size());
  points.colors.reserve(3 * model.points.size());
  for (const ColmapPoint& point : model.points) {
    points.positions.insert(points.positions.end(), point.position.begin(), point.position.end());
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

SceneModel read_colmap_scene(const SceneOptions& options) {
  const SparseModelFolder found = find_model_folder(options.source_path);
  SceneModel scene;
  scene.model = read_colmap_model(found.folder, options.tracks);
  scene.points = points_of(scene.model);
  scene.visible_points = visible_points(scene.model);
  scene.model.points = {};
  const std::string folder = found.folder.lexically_relative(options.source_path).string();
  scene.description = detail::concat(folder.empty() ? found.folder.string() : folder,
                                     found.format == ColmapFormat::kBinary ? ", binary" : ", text");
  scene.notes = found.notes;
  for (const auto& [id, camera] : scene.model.cameras) {
    scene.camera_places[id] = detail::concat(found.folder.string(), ": camera ", id);
  }
  return scene;
}

bool lies_in(const fs::path& folder, const fs::path& file) {
  const fs::path inside = file.lexically_relative(folder);
  return !inside.empty() && *inside.begin() != "..";
}

// The scene folder and, for paths as "../images/0.jpg", the folder that it is in, unless that is the root.
fs::path reach_of(const fs::path& source) {
  const fs::path folder = (source / "").lexically_normal().parent_path(), parent = folder.parent_path();
  return parent == folder.root_path() ? folder : parent;
}

// A transforms.json from elsewhere must not copy other pictures of this machine into a model. Links that lead out of
// the folder were made by the user and are followed.
bool is_within_reach(const fs::path& file, const fs::path& source) {
  if (lies_in(reach_of(fs::absolute(source)), fs::absolute(file).lexically_normal())) return true;
  std::error_code error;
  return lies_in(reach_of(fs::weakly_canonical(source, error)), fs::weakly_canonical(file, error));
}

void check_reach(const fs::path& file, const fs::path& source, const std::string& place) {
  if (is_within_reach(file, source)) return;
  input_error(place, ": expected a file in the scene folder or the folder that it is in, found ",
              file.lexically_normal().string(), "; move or link it there, and change the path");
}

// Where frames of a transforms.json are to be found: "train/r_0.png" also below images_4/.
std::map<std::string, fs::path> existing(const std::map<std::string, fs::path>& files, const fs::path& source,
                                         const ImageFolder& images) {
  std::map<std::string, fs::path> found;
  for (const auto& [name, file] : files) {
    if (!images.find(name).empty() || !is_file(file)) continue;
    check_reach(file, source, detail::concat(source.string(), ": file_path of the photograph ", name));
    found[name] = file;
  }
  return found;
}

void choose_held_out(const TransformsModel& transforms, const TransformsFiles& files, std::size_t n_train, bool eval,
                     SceneModel& scene) {
  if (!files.held_out.empty()) {
    scene.split_description = files.held_out.filename().string();
    scene.has_split = true;
    for (std::size_t i = n_train; i < scene.model.images.size(); ++i) scene.held_out.insert(scene.model.images[i].name);
    return;
  }
  const bool has_test = !transforms.listed_as_test.empty();
  const std::set<std::string>& listed = has_test ? transforms.listed_as_test : transforms.listed_as_validation;
  if (listed.empty()) return;
  const char* key = has_test ? "test_filenames" : "val_filenames";
  scene.has_split = true;
  scene.split_description = detail::concat(key, " of ", files.train.filename().string());
  std::vector<ColmapImage> others;  // that --eval does not leave out
  for (ColmapImage& image : scene.model.images) {
    if (listed.count(image.name) > 0) scene.held_out.insert(image.name);
    if (listed.count(image.name) > 0 || transforms.listed_as_validation.count(image.name) == 0) others.push_back(image);
  }
  if (!eval) return;
  if (scene.held_out.empty()) {
    input_error(files.train.string(), ": ", key, ": expected names as in file_path of \"frames\", found none in its ",
                listed.size(), " (first: ", listed.begin()->substr(0, 100), "); correct or remove the list");
  }
  std::set<std::string> unknown = listed;
  for (const std::string& name : scene.held_out) unknown.erase(name);
  if (!unknown.empty()) {
    scene.warnings.push_back(detail::concat(files.train.string(), ": ", key, ": ", unknown.size(), " of ",
                                            listed.size(), " names are not in \"frames\" (the first: ",
                                            unknown.begin()->substr(0, 100), "); expected names as in file_path"));
  }
  if (others.size() < scene.model.images.size()) {
    scene.notes.push_back(detail::concat("val_filenames: ", scene.model.images.size() - others.size(),
                                         " views are neither trained on nor tested"));
    scene.model.images = std::move(others);
  }
}

SceneModel read_transforms_scene(const SceneOptions& options, const TransformsFiles& files, const ImageFolder& images) {
  TransformsModel transforms;
  const PhotographSizeFn size_of = [&](const std::string& name) -> std::optional<ImageSize> {
    const fs::path in_folder = images.find_all({name})[name];
    if (!in_folder.empty()) return read_image_size(in_folder);
    const auto named = transforms.files.find(name);
    const bool is_there = named != transforms.files.end() && is_file(named->second);
    if (!is_there || !is_within_reach(named->second, options.source_path)) return std::nullopt;
    return read_image_size(named->second);
  };
  read_transforms(files.train, size_of, transforms);
  const std::size_t n_train = transforms.model.images.size();
  if (options.eval && !files.held_out.empty()) read_transforms(files.held_out, size_of, transforms);

  SceneModel scene;
  scene.model = std::move(transforms.model);
  scene.description = files.train.filename().string();
  scene.notes = files.notes;
  scene.camera_places = std::move(transforms.camera_places);
  scene.files = existing(transforms.files, options.source_path, images);
  for (const auto& [name, mask] : transforms.masks) {
    check_reach(mask, options.source_path, detail::concat(options.source_path, ": mask_path of the photograph ", name));
  }
  scene.masks = std::move(transforms.masks);
  if (!transforms.points.empty()) {
    check_reach(transforms.points, options.source_path, files.train.string() + ": ply_file_path");
  }
  choose_held_out(transforms, files, n_train, options.eval, scene);
  if (!transforms.points.empty()) {
    scene.points = read_point_ply(transforms.points);
    scene.points_description = transforms.points.filename().string();
  }
  return scene;
}

}  // namespace

bool holds_scene(const fs::path& source) {
  return find_transforms(source).found() || has_model_folder(source);
}

SceneModel read_scene_model(const SceneOptions& options, const ImageFolder& images) {
  const TransformsFiles files = find_transforms(options.source_path);
  if (files.found() && !has_model_folder(options.source_path)) return read_transforms_scene(options, files, images);
  SceneModel scene = read_colmap_scene(options);
  if (files.found()) {
    scene.notes.push_back(detail::concat(files.train.filename().string(), " is not used, because there is a model in ",
                                         scene.description));
  }
  return scene;
}

}  // namespace b3dgs
