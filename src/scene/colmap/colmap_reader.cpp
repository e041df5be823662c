// Finds the COLMAP model of a scene folder, and checks the values of its files: whatever read_colmap_model() returns
// must be usable.
#include <algorithm>
#include <cmath>
#include <set>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::array<const char*, 3> kFiles{"cameras", "images", "points3D"};
constexpr std::uint64_t kMaxImageSide = 1u << 20;  // px; larger only in damaged files
constexpr double kMaxCoordinate = 1e12;            // world units; its square is finite in single precision

const char* extension_of(ColmapFormat format) {
  return format == ColmapFormat::kBinary ? ".bin" : ".txt";
}

int files_there(const fs::path& folder, ColmapFormat format) {
  return static_cast<int>(std::count_if(kFiles.begin(), kFiles.end(), [&](const char* stem) {
    std::error_code error;
    return fs::is_regular_file(colmap::file_of(folder, stem, format), error);
  }));
}

void check_camera(const std::string& file, const ColmapCamera& camera) {
  const std::string place = detail::concat(file, ": camera ", camera.id);
  if (camera.width < 1 || camera.height < 1 || camera.width > kMaxImageSide || camera.height > kMaxImageSide) {
    input_error(place, ": expected a width and height of 1 to ", kMaxImageSide, " px, found ", camera.width, " x ",
                camera.height, "; the file is damaged");
  }
  for (const double value : camera.params) {
    if (!std::isfinite(value)) {
      input_error(place, " (", camera_model_name(camera.model), "): expected finite parameters ",
                  camera_model_params(camera.model), ", found ", value, "; reconstruct the scene again");
    }
  }
}

// Outputs are named after images too, so a name must not point outside a folder.
bool points_outside(const std::string& name) {
  std::string path = name;
  std::replace(path.begin(), path.end(), '\\', '/');
  const fs::path relative(path);
  return relative.is_absolute() ||
         std::any_of(relative.begin(), relative.end(), [](const fs::path& part) { return part == ".."; });
}

void check_image(const std::string& file, const ColmapImage& image, const ColmapModel& model) {
  const std::string place = detail::concat(file, ": image ", image.id, " (", image.name, ")");
  const auto is_finite = [](double value) { return std::isfinite(value); };
  if (!std::all_of(image.quat.begin(), image.quat.end(), is_finite) ||
      !std::all_of(image.translation.begin(), image.translation.end(), is_finite)) {
    input_error(place, ": its pose is not finite; remove the image from the model or reconstruct the scene again");
  }
  double squared_length = 0;
  for (const double value : image.quat) squared_length += value * value;
  if (!(squared_length > 1e-12 && squared_length < 1e12)) {
    input_error(place, ": expected a rotation quaternion of length 1, found length ", std::sqrt(squared_length),
                "; remove the image from the model or reconstruct the scene again");
  }
  for (const double value : image.translation) {
    if (std::abs(value) > kMaxCoordinate) {
      input_error(place, ": expected a translation of at most ", kMaxCoordinate, ", found the component ", value,
                  "; scale the model down or reconstruct the scene again");
    }
  }
  if (image.name.empty()) input_error(place, ": expected the name of an image file, found an empty name");
  if (points_outside(image.name) || detail::one_line(image.name) != image.name) {
    input_error(place,
                ": expected a path inside the image folder, without \"..\" and control characters; "
                "rename the image in the model");
  }
  if (model.cameras.count(image.camera_id) == 0) {
    std::string known;
    std::size_t listed = 0;
    for (const auto& [id, camera] : model.cameras) {
      if (++listed > 8) {
        known += ", ...";
        break;
      }
      known += (known.empty() ? "" : ", ") + std::to_string(id);
    }
    input_error(place, ": camera ", image.camera_id, " is not in the cameras file, which has ",
                known.empty() ? "none" : known, "; the files belong to different models");
  }
}

void check_images(const std::string& file, const ColmapModel& model) {
  std::set<std::uint32_t> ids;
  std::set<std::string> names;
  for (const ColmapImage& image : model.images) {
    check_image(file, image, model);
    if (!ids.insert(image.id).second) input_error(file, ": two images have the ID ", image.id, "; the file is damaged");
    if (!names.insert(image.name).second)
      input_error(file, ": two images have the name ", image.name, "; the file is damaged");
  }
}

void check_points(const std::string& file, const std::vector<ColmapPoint>& points) {
  std::vector<std::uint64_t> ids;
  ids.reserve(points.size());
  for (const ColmapPoint& point : points) {
    for (const double value : point.position) {
      if (!(std::abs(value) <= kMaxCoordinate)) {
        input_error(file, ": point ", point.id, ": expected coordinates of at most ", kMaxCoordinate, ", found ", value,
                    "; remove the point or reconstruct the scene again");
      }
    }
    ids.push_back(point.id);
  }
  std::sort(ids.begin(), ids.end());
  const auto twice = std::adjacent_find(ids.begin(), ids.end());
  if (twice != ids.end()) input_error(file, ": two points have the ID ", *twice, "; the file is damaged");
}

struct Candidate {
  fs::path folder;
  std::uint64_t n_images = 0;
};

// 2 before 10.
bool by_number_then_name(const fs::path& a, const fs::path& b) {
  const std::string left = a.filename().string(), right = b.filename().string();
  const auto is_number = [](const std::string& text) {
    return text.find_first_not_of("0123456789") == std::string::npos;
  };
  if (is_number(left) && is_number(right) && left.size() != right.size()) return left.size() < right.size();
  return left < right;
}

std::vector<fs::path> folders_to_search(const fs::path& source) {
  std::vector<fs::path> folders;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(source / "sparse", error)) {
    if (entry.is_directory(error)) folders.push_back(entry.path());
  }
  std::sort(folders.begin(), folders.end(), by_number_then_name);
  folders.push_back(source / "sparse");
  folders.push_back(source);
  return folders;
}

}  // namespace

fs::path colmap::file_of(const fs::path& folder, const char* stem, ColmapFormat format) {
  return folder / (std::string(stem) + extension_of(format));
}

std::optional<ColmapFormat> colmap_format(const fs::path& folder) {
  const int binary = files_there(folder, ColmapFormat::kBinary), text = files_there(folder, ColmapFormat::kText);
  if (std::max(binary, text) < 2) return std::nullopt;  // a single file with such a name may be anything
  return binary >= text ? ColmapFormat::kBinary : ColmapFormat::kText;
}

ColmapModel read_colmap_model(const ColmapFiles& files, ColmapFormat format, bool tracks) {
  ColmapModel model = colmap::read_unchecked(files, format, tracks);
  for (const auto& [id, camera] : model.cameras) check_camera(files.cameras.name(), camera);
  check_images(files.images.name(), model);
  check_points(files.points.name(), model.points);
  return model;
}

ColmapModel read_colmap_model(const fs::path& folder, bool tracks) {
  const std::optional<ColmapFormat> format = colmap_format(folder);
  if (!format) {
    input_error(folder.string(),
                ": no COLMAP model found (expected cameras, images and points3D, as .bin or .txt files)");
  }
  for (const char* stem : kFiles) {
    const fs::path file = colmap::file_of(folder, stem, *format);
    if (!fs::exists(file)) {
      input_error(file.string(), ": file not found; a COLMAP model has the files cameras, images and points3D, all ",
                  extension_of(*format));
    }
  }
  FileReader cameras(colmap::file_of(folder, "cameras", *format)), images(colmap::file_of(folder, "images", *format)),
      points(colmap::file_of(folder, "points3D", *format));
  return read_colmap_model({cameras, images, points}, *format, tracks);
}

bool has_model_folder(const fs::path& source) {
  const std::vector<fs::path> folders = folders_to_search(source);
  return std::any_of(folders.begin(), folders.end(), [](const fs::path& folder) { return colmap_format(folder); });
}

SparseModelFolder find_model_folder(const fs::path& source) {
  if (!fs::is_directory(source)) {
    if (!fs::exists(source))
      input_error("scene folder not found: ", source.string(), " (expected images/ and sparse/0/)");
    input_error("scene is not a folder: ", source.string(), " (expected a folder with images/ and sparse/0/); ",
                "`b3dgs reconstruct PHOTOS|VIDEO SCENE` makes a scene");
  }
  std::vector<Candidate> candidates;
  for (const fs::path& folder : folders_to_search(source)) {
    if (colmap_format(folder)) candidates.push_back({folder, 0});
  }
  if (candidates.empty()) {
    input_error(
        source.string(), ": no COLMAP model found in sparse/0, sparse/N or sparse/ (expected cameras, images and ",
        "points3D, as .bin or .txt files), and no transforms.json or transforms_train.json; `b3dgs reconstruct ",
        "PHOTOS SCENE` makes a scene from photographs, or choose another folder with -s");
  }
  const auto format_of = [](const Candidate& candidate) { return *colmap_format(candidate.folder); };
  if (candidates.size() == 1) return {candidates[0].folder, format_of(candidates[0]), {}};
  std::vector<std::string> notes;
  for (Candidate& candidate : candidates) {
    try {
      candidate.n_images = count_colmap_images(candidate.folder);
    } catch (const InputError& error) {  // reading this model reports it again if no other one is valid
      notes.push_back(error.what());
    }
  }
  const auto best = std::max_element(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return a.n_images < b.n_images;  // the first of equals
  });
  std::string others;
  for (const Candidate& candidate : candidates) {
    if (candidate.folder == best->folder) continue;
    others += detail::concat(others.empty() ? "" : ", ", candidate.folder.lexically_relative(source).string(), " (",
                             candidate.n_images, ")");
  }
  notes.push_back(detail::concat(candidates.size(), " models: using ", best->folder.lexically_relative(source).string(),
                                 ", which has the most images (", best->n_images, "); ignoring ", others));
  return {best->folder, format_of(*best), std::move(notes)};
}

}  // namespace b3dgs
