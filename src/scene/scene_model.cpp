#include "scene/scene_model.h"

#include <algorithm>
#include <optional>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "core/files/own_files.h"
#include "core/files/unicode_names.h"
#include "core/text.h"
#include "scene/images/image.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

WorldPoints points_of(const ColmapModel& model) {
  WorldPoints points;
  points.left_out = model.left_out_points;
  points.positions.reserve(3 * model.points.size());
  points.colors.reserve(3 * model.points.size());
  for (const ColmapPoint& point : model.points) {
    points.positions.insert(points.positions.end(), point.position.begin(), point.position.end());
    points.colors.insert(points.colors.end(), point.color.begin(), point.color.end());
  }
  return points;
}

/// Returns the indices of the points in each image's tracks, by image ID, ascending.
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

// Warns about listed names that are unknown. `where` names the list they are compared with.
void check_list(const std::string& list, const char* where, const std::set<std::string>& listed, SceneModel& scene) {
  std::set<std::string> unknown = listed;
  for (const ColmapImage& image : scene.model.images) unknown.erase(image.name);
  for (const LeftOutImage& image : scene.model.left_out) unknown.erase(image.name);
  if (unknown.empty()) return;
  const std::string first = unknown.begin()->substr(0, 100);
  if (unknown.size() == listed.size()) {
    input_error(list, ": expected names as in ", where, ", found none in its ", listed.size(), " (first: ", first,
                "); correct or remove the list");
  }
  scene.warnings.push_back(detail::concat(list, ": ", unknown.size(), " of ", listed.size(),
                                          " names are unknown (the first: ", first, "); expected names as in ", where));
}

// The original program and its successors hold out the views that a test.txt beside the model lists, one per line. A
// test.txt without the name of any image may be unrelated, so it is rejected only beside the model of a training.
void read_test_list(const fs::path& model_folder, const SceneOptions& options, const ImageFolder& images,
                    SceneModel& scene) {
  const fs::path source = options.source_path;
  for (const fs::path& folder : {model_folder, source / "sparse", source}) {
    const fs::path path = folder / "test.txt";
    if (!is_file(path)) continue;
    std::map<std::string, std::string> names;  // names of images, also without extension
    const auto add = [&](const std::string& name) {
      names[composed_name(name)] = name;
      names.emplace(composed_name(fs::path(name).replace_extension().string()), name);
    };
    std::vector<std::string> registered;
    for (const ColmapImage& image : scene.model.images) registered.push_back(image.name);
    std::map<fs::path, std::string> names_of_files;
    for (const auto& [name, photograph] : images.find_all(registered)) names_of_files[photograph] = name;
    for (const std::string& name : registered) add(name);
    for (const LeftOutImage& image : scene.model.left_out) add(image.name);
    FileReader file(path);
    bool is_any_known = false;
    std::set<std::string> listed;
    for (std::string_view line; file.read_line(line);) {
      const std::string_view word = TextFields(line).rest();
      if (word.empty() || word[0] == '#') continue;
      const std::string name(word);
      const auto same = names.find(composed_name(name));
      const auto similar = names_of_files.find(images.find_all({name})[name]);
      is_any_known = is_any_known || same != names.end() || similar != names_of_files.end();
      listed.insert(same != names.end() ? same->second : similar != names_of_files.end() ? similar->second : name);
    }
    if (listed.empty()) return;
    const bool is_beside_model = folder == model_folder;
    if (!is_any_known && !(is_beside_model && options.eval && options.needs_training_views)) {
      if (options.eval) {
        scene.warnings.push_back(detail::concat(path.string(), " is ignored: expected names as in the model, found ",
                                                "none in its ", listed.size(),
                                                " (first: ", listed.begin()->substr(0, 100), ")"));
      }
      if (is_beside_model) return;
      continue;
    }
    scene.split = path.lexically_relative(source).string();
    scene.held_out = listed;
    if (options.eval) check_list(path.string(), "the model", listed, scene);
    return;
  }
}

SceneModel read_colmap_scene(const SceneOptions& options, const ImageFolder& images) {
  const SparseModelFolder found = find_model_folder(options.source_path);
  SceneModel scene;
  const bool is_binary = colmap_format(found.folder) == ColmapFormat::kBinary;
  const std::string own = is_binary ? "points3D.bin" : "points3D.txt", ply = "points3D.ply";
  std::string points = own;
  for (const std::string& name : {own, std::string(is_binary ? "points3D.txt" : "points3D.bin"), ply}) {
    if (!is_file(found.folder / name)) continue;
    points = name;
    break;
  }
  const bool uses_ply = points == ply;
  scene.model = read_colmap_model(found.folder, options.tracks ? Observations::kTracks : Observations::kNone,
                                  /*needs_points=*/options.seed_points && !uses_ply);
  scene.points = uses_ply ? read_point_ply(found.folder / ply) : points_of(scene.model);
  if (points != own) scene.points_description = points;
  scene.visible_points = visible_points(scene.model);
  scene.model.points = {};
  const std::string folder = found.folder.lexically_relative(options.source_path).string();
  scene.file = (found.folder / (is_binary ? "images.bin" : "images.txt")).string();
  scene.description = (folder.empty() ? found.folder.string() : folder) + (is_binary ? ", binary" : ", text");
  scene.notes = found.notes;
  read_test_list(found.folder, options, images, scene);
  for (const auto& [id, camera] : scene.model.cameras) {
    scene.camera_places[id] = detail::concat(found.folder.string(), ": camera ", id);
  }
  return scene;
}

bool lies_in(const fs::path& folder, const fs::path& file) {
  const fs::path inside = file.lexically_relative(folder);
  return !inside.empty() && *inside.begin() != "..";
}

// Returns the scene folder or, for paths such as "../images/0.jpg", its parent folder, unless that is the root.
fs::path reach_of(const fs::path& source) {
  const fs::path folder = (source / "").lexically_normal().parent_path(), parent = folder.parent_path();
  return parent == folder.root_path() ? folder : parent;
}

// A downloaded transforms.json must not copy other pictures of this machine into a model. The user made links that lead
// out of the folder, so they are followed.
bool is_within_reach(const fs::path& file, const fs::path& source) {
  if (lies_in(reach_of(fs::absolute(source)), fs::absolute(file).lexically_normal())) return true;
  return lies_in(reach_of(real_path(source)), real_path(file));
}

void check_reach(const fs::path& file, const fs::path& source, const std::string& place) {
  if (is_within_reach(file, source)) return;
  input_error(place, ": expected a file in the scene folder or the folder that it is in, found ",
              file.lexically_normal().string(), "; move or link it there, and change the path");
}

template <class Is>
void leave_out(const Is& is, const char* note, SceneModel& scene) {
  std::vector<ColmapImage>& images = scene.model.images;
  const auto end = std::remove_if(images.begin(), images.end(), [&](const auto& image) { return is(image.name); });
  if (const auto n = images.end() - end; n > 0)
    scene.notes.push_back(detail::concat(note, ": ", n, n == 1 ? " view" : " views"));
  images.erase(end, images.end());
}

// If a list names the training views, views in none of the lists are left out. Otherwise one of the other lists names
// the views to hold out. With --eval, views that only the validation list names are left out of training too.
void apply_lists(const TransformsModel& transforms, const std::string& file, bool eval, SceneModel& scene) {
  constexpr const char* kFilePath = "file_path of \"frames\"";
  const std::set<std::string>&training = transforms.listed_for_training, &test = transforms.listed_as_test,
        &validation = transforms.listed_as_validation, &held_out = test.empty() ? validation : test;
  if (!training.empty()) {
    check_list(file + ": train_filenames", kFilePath, training, scene);
    leave_out([&](const auto& name) { return training.count(name) + test.count(name) + validation.count(name) == 0; },
              "left out, in neither train_filenames, val_filenames nor test_filenames", scene);
  }
  if (held_out.empty()) return;
  const char* key = test.empty() ? "val_filenames" : "test_filenames";
  scene.split = detail::concat(key, " of ", fs::path(file).filename().string());
  scene.held_out = held_out;
  if (!eval) return;
  check_list(detail::concat(file, ": ", key), kFilePath, held_out, scene);
  leave_out([&](const auto& name) { return validation.count(name) > 0 && held_out.count(name) == 0; },
            "only in val_filenames, so neither trained on nor tested", scene);
}

/// Finds the photographs that file_path names, to determine the size that intrinsics in px belong to. With -i, reduced
/// copies may replace them.
class NamedPhotographs {
 public:
  NamedPhotographs(const SceneOptions& options, const ImageFolder& images)
      : source_(options.source_path), used_(images), originals_(images) {
    if (options.images != "images") originals_ = ImageFolder(source_, "images");
  }

  /// `file`: file_path, relative to the scene's file.
  PhotographSizes sizes_of(const std::string& name, const fs::path& file) {
    fs::path named = find_named(file);
    if (named.empty()) named = originals_.find_all({name})[name];
    if (!named.empty()) return {read_image_size(named)};
    const fs::path used = used_.find_all({name})[name];
    return used.empty() ? PhotographSizes{} : PhotographSizes{{}, read_image_size(used)};
  }

 private:
  // Also finds names with another extension or case.
  fs::path find_named(const fs::path& file) {
    if (!is_within_reach(file, source_)) return {};
    if (is_file(file)) return file;
    const fs::path folder = file.lexically_normal().parent_path(), name = file.filename();
    std::error_code error;
    if (!fs::is_directory(folder, error) || fs::equivalent(folder, source_, error)) return {};
    const auto entry = folders_.try_emplace(folder, folder.parent_path(), folder.filename().string()).first;
    return entry->second.find_all({name.string()})[name.string()];
  }

  fs::path source_;
  const ImageFolder& used_;
  ImageFolder originals_;
  std::map<fs::path, ImageFolder> folders_;
};

SceneModel read_transforms_scene(const SceneOptions& options, const TransformsFiles& files, const ImageFolder& images) {
  TransformsModel transforms;
  NamedPhotographs photographs(options, images);
  const PhotographSizesFn sizes_of = [&](const std::string& name) {
    return photographs.sizes_of(name, transforms.files.at(name));
  };
  const auto read = [&](const fs::path& path) {
    FileReader file(path);
    std::string text(file.remaining(), '\0');
    file.read_bytes(text.data(), text.size());
    read_transforms(text, path, sizes_of, transforms);
  };
  read(files.train);
  const std::size_t n_train = transforms.model.images.size();
  SceneModel scene;
  scene.file = files.train.string();
  if (options.eval && !files.held_out.empty()) {
    read(files.held_out);
    scene.file += " or " + files.held_out.filename().string();
  }
  scene.model = std::move(transforms.model);
  scene.description = files.train.filename().string();
  scene.notes = files.notes;
  scene.camera_places = std::move(transforms.camera_places);
  for (const auto& [name, file] : transforms.files) {  // "train/r_0.png" may also be below images_4/
    if (!images.find(name).empty() || images.replaces(name) || !is_file(file)) continue;
    check_reach(file, options.source_path, scene.file + ": file_path of the photograph " + name);
    scene.files[name] = file;
  }
  for (const auto& [name, mask] : transforms.masks) {
    check_reach(mask, options.source_path, scene.file + ": mask_path of the photograph " + name);
  }
  scene.masks = std::move(transforms.masks);
  if (files.held_out.empty()) {
    apply_lists(transforms, files.train.string(), options.eval, scene);
  } else {
    scene.split = files.held_out.filename().string();
    for (std::size_t i = n_train; i < scene.model.images.size(); ++i) scene.held_out.insert(scene.model.images[i].name);
  }
  if (!transforms.points.empty()) {
    const std::string place = files.train.string() + ": ply_file_path";
    check_reach(transforms.points, options.source_path, place);
    if (!is_file(transforms.points)) {
      input_error(place, ": file not found: ", transforms.points.string(),
                  "; correct the path, or remove it to find points in the photographs");
    }
    scene.points = read_point_ply(transforms.points);
    scene.points_description = transforms.points.filename().string();
  }
  return scene;
}

}  // namespace

bool holds_scene(const fs::path& source) {
  return !find_transforms(source).train.empty() || has_model_folder(source);
}

SceneModel read_scene_model(const SceneOptions& options, const ImageFolder& images) {
  const TransformsFiles files = find_transforms(options.source_path);
  if (files.train.empty()) return read_colmap_scene(options, images);
  if (!has_model_folder(options.source_path)) return read_transforms_scene(options, files, images);
  SceneModel scene = read_colmap_scene(options, images);
  scene.notes.push_back(files.train.filename().string() + " is not used, because there is a model in " +
                        scene.description);
  return scene;
}

}  // namespace b3dgs
