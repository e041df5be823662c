// A COLMAP model from its folder: which files, and whether their values make a model.
#include <algorithm>
#include <cmath>
#include <set>

#include "check.h"
#include "scene/colmap.h"
#include "scene/colmap_format.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::array<const char*, 3> kFiles{"cameras", "images", "points3D"};
constexpr std::uint64_t kMaxImageSide = 1u << 20;  // px; more is a damaged file

const char* extension_of(ColmapFormat format) {
  return format == ColmapFormat::kBinary ? ".bin" : ".txt";
}

fs::path file_of(const fs::path& folder, const char* stem, ColmapFormat format) {
  return folder / (std::string(stem) + extension_of(format));
}

int files_there(const fs::path& folder, ColmapFormat format) {
  return static_cast<int>(std::count_if(kFiles.begin(), kFiles.end(), [&](const char* stem) {
    std::error_code error;
    return fs::is_regular_file(file_of(folder, stem, format), error);
  }));
}

void check_camera(const fs::path& file, const ColmapCamera& camera) {
  const std::string place = detail::concat(file.string(), ": camera ", camera.id);
  if (camera.width < 1 || camera.height < 1 || camera.width > kMaxImageSide || camera.height > kMaxImageSide) {
    input_error(place, " has the size ", camera.width, " x ", camera.height, ", expected 1 to ", kMaxImageSide,
                " px a side; the file is damaged");
  }
  for (const double value : camera.params) {
    if (!std::isfinite(value)) {
      input_error(place, " (", camera_model_name(camera.model), "): expected finite parameters ",
                  camera_model_params(camera.model), ", found ", value, "; reconstruct the scene again");
    }
  }
}

void check_image(const fs::path& file, const ColmapImage& image, const ColmapModel& model) {
  const std::string place = detail::concat(file.string(), ": image ", image.id, " (", image.name, ")");
  const auto is_finite = [](double value) { return std::isfinite(value); };
  if (!std::all_of(image.quat.begin(), image.quat.end(), is_finite) ||
      !std::all_of(image.translation.begin(), image.translation.end(), is_finite)) {
    input_error(place, ": its pose is not finite; remove the image from the model or reconstruct the scene again");
  }
  double squared_norm = 0;
  for (const double value : image.quat) squared_norm += value * value;
  if (!(squared_norm > 1e-12)) {
    input_error(place, ": its rotation is a quaternion of length 0; remove the image from the model");
  }
  if (image.name.empty()) input_error(place, ": expected the name of an image file, found an empty name");
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
    input_error(place, ": its camera ", image.camera_id, " is not in the cameras file, which has ",
                known.empty() ? "none" : known, "; the files are of different models");
  }
}

void check_images(const fs::path& file, const ColmapModel& model) {
  std::set<std::uint32_t> ids;
  std::set<std::string> names;
  for (const ColmapImage& image : model.images) {
    check_image(file, image, model);
    if (!ids.insert(image.id).second) input_error(file.string(), ": two images have the id ", image.id);
    if (!names.insert(image.name).second) input_error(file.string(), ": two images have the name ", image.name);
  }
}

void check_points(const fs::path& file, const std::vector<ColmapPoint>& points) {
  std::vector<std::uint64_t> ids;
  ids.reserve(points.size());
  for (const ColmapPoint& point : points) {
    for (const double value : point.position) {
      if (!std::isfinite(static_cast<float>(value))) {
        input_error(file.string(), ": point ", point.id, ": expected a finite position, found ", value,
                    "; remove the point or reconstruct the scene again");
      }
    }
    ids.push_back(point.id);
  }
  std::sort(ids.begin(), ids.end());
  const auto twice = std::adjacent_find(ids.begin(), ids.end());
  if (twice != ids.end()) input_error(file.string(), ": two points have the id ", *twice, "; the file is damaged");
}

}  // namespace

void colmap::add_camera(std::map<std::uint32_t, ColmapCamera>& cameras, ColmapCamera camera, const std::string& place) {
  const std::uint32_t id = camera.id;
  if (!cameras.emplace(id, std::move(camera)).second) input_error(place, ": two cameras have the id ", id);
}

std::optional<ColmapFormat> colmap_format(const fs::path& folder) {
  const int binary = files_there(folder, ColmapFormat::kBinary), text = files_there(folder, ColmapFormat::kText);
  if (std::max(binary, text) < 2) return std::nullopt;  // a single file of such a name may be anything
  return binary >= text ? ColmapFormat::kBinary : ColmapFormat::kText;
}

std::uint64_t count_colmap_images(const fs::path& folder) {
  const ColmapFormat format = colmap_format(folder).value_or(ColmapFormat::kBinary);
  const fs::path file = file_of(folder, "images", format);
  return format == ColmapFormat::kBinary ? colmap::count_images_binary(file) : colmap::read_images_text(file).size();
}

ColmapModel read_colmap_model(const fs::path& folder) {
  const std::optional<ColmapFormat> format = colmap_format(folder);
  if (!format) {
    input_error(folder.string(), ": expected a COLMAP model (cameras, images and points3D, .bin or .txt), found none");
  }
  for (const char* stem : kFiles) {
    const fs::path file = file_of(folder, stem, *format);
    if (!fs::exists(file)) {
      input_error(file.string(), ": is missing; a COLMAP model has cameras, images and points3D, all ",
                  extension_of(*format));
    }
  }
  const fs::path cameras = file_of(folder, "cameras", *format), images = file_of(folder, "images", *format),
                 points = file_of(folder, "points3D", *format);
  const bool binary = *format == ColmapFormat::kBinary;
  ColmapModel model;
  model.cameras = binary ? colmap::read_cameras_binary(cameras) : colmap::read_cameras_text(cameras);
  for (const auto& [id, camera] : model.cameras) check_camera(cameras, camera);
  model.images = binary ? colmap::read_images_binary(images) : colmap::read_images_text(images);
  check_images(images, model);
  model.points = binary ? colmap::read_points_binary(points) : colmap::read_points_text(points);
  check_points(points, model.points);
  return model;
}

}  // namespace b3dgs
