// Writes COLMAP models, without 2D points and tracks.
#include <cstdio>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

template <class T>
void append(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

std::string cameras_binary(const ColmapModel& model) {
  std::string bytes;
  append(bytes, static_cast<std::uint64_t>(model.cameras.size()));
  for (const auto& [id, camera] : model.cameras) {
    append(bytes, id);
    append(bytes, static_cast<std::int32_t>(camera.model));
    append(bytes, camera.width);
    append(bytes, camera.height);
    for (const double value : camera.params) append(bytes, value);
  }
  return bytes;
}

std::string images_binary(const ColmapModel& model) {
  std::string bytes;
  append(bytes, static_cast<std::uint64_t>(model.images.size()));
  for (const ColmapImage& image : model.images) {
    append(bytes, image.id);
    for (const double value : image.quat) append(bytes, value);
    for (const double value : image.translation) append(bytes, value);
    append(bytes, image.camera_id);
    bytes.append(image.name).push_back('\0');
    append(bytes, std::uint64_t{0});  // 2D points
  }
  return bytes;
}

std::string points_binary(const ColmapModel& model) {
  std::string bytes;
  append(bytes, static_cast<std::uint64_t>(model.points.size()));
  for (const ColmapPoint& point : model.points) {
    append(bytes, point.id);
    for (const double value : point.position) append(bytes, value);
    for (const std::uint8_t value : point.color) append(bytes, value);
    append(bytes, point.error);
    append(bytes, std::uint64_t{0});  // track
  }
  return bytes;
}

// 17 digits are enough to read back the same double.
void append_real(std::string& text, double value) {
  char digits[32];
  std::snprintf(digits, sizeof(digits), " %.17g", value);
  text += digits;
}

std::string cameras_text(const ColmapModel& model) {
  std::string text = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  text += "# Number of cameras: " + std::to_string(model.cameras.size()) + "\n";
  for (const auto& [id, camera] : model.cameras) {
    text += detail::concat(id, " ", camera_model_name(camera.model), " ", camera.width, " ", camera.height);
    for (const double value : camera.params) append_real(text, value);
    text += "\n";
  }
  return text;
}

std::string images_text(const ColmapModel& model) {
  std::string text =
      "# Image list with two lines of data per image:\n"
      "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n";
  text += "# Number of images: " + std::to_string(model.images.size()) + ", mean observations per image: 0\n";
  for (const ColmapImage& image : model.images) {
    text += std::to_string(image.id);
    for (const double value : image.quat) append_real(text, value);
    for (const double value : image.translation) append_real(text, value);
    text += detail::concat(" ", image.camera_id, " ", image.name, "\n\n");
  }
  return text;
}

std::string points_text(const ColmapModel& model) {
  std::string text =
      "# 3D point list with one line of data per point:\n"
      "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
  text += "# Number of points: " + std::to_string(model.points.size()) + ", mean track length: 0\n";
  for (const ColmapPoint& point : model.points) {
    text += std::to_string(point.id);
    for (const double value : point.position) append_real(text, value);
    for (const std::uint8_t value : point.color) text += " " + std::to_string(value);
    append_real(text, point.error);
    text += "\n";
  }
  return text;
}

}  // namespace

void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model, ColmapFormat format) {
  for (const auto& [id, camera] : model.cameras) {
    B3DGS_CHECK(camera.params.size() == static_cast<std::size_t>(camera_model_param_count(camera.model)), "camera ", id,
                " has ", camera.params.size(), " parameters");
  }
  if (format == ColmapFormat::kBinary) {
    write_file(folder / "cameras.bin", cameras_binary(model));
    write_file(folder / "images.bin", images_binary(model));
    write_file(folder / "points3D.bin", points_binary(model));
  } else {
    write_file(folder / "cameras.txt", cameras_text(model));
    write_file(folder / "images.txt", images_text(model));
    write_file(folder / "points3D.txt", points_text(model));
  }
}

}  // namespace b3dgs
