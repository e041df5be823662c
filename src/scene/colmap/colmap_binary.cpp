// COLMAP's binary files: a 64-bit count, then records without padding, little-endian.
#include "core/check.h"
#include "scene/colmap/colmap_format.h"

namespace b3dgs::colmap {
namespace {

// Bytes of the smallest record of each kind.
constexpr std::uint64_t kMinCameraBytes = 4 + 4 + 8 + 8 + 3 * 8;         // SIMPLE_PINHOLE
constexpr std::uint64_t kMinImageBytes = 4 + 4 * 8 + 3 * 8 + 4 + 2 + 8;  // a name of one letter, no 2D points
constexpr std::uint64_t kMinPointBytes = 8 + 3 * 8 + 3 + 8 + 8;          // no track
constexpr std::uint64_t kPoint2dBytes = 2 * 8 + 8, kTrackElementBytes = 2 * 4;

std::uint64_t read_count(FileReader& file, const char* kind, std::uint64_t min_bytes) {
  const auto count = file.read<std::uint64_t>();
  file.expect_records(kind, count, min_bytes);
  return count;
}

template <std::size_t N>
void read_into(FileReader& file, std::array<double, N>& values) {
  for (double& value : values) value = file.read<double>();
}

}  // namespace

std::map<std::uint32_t, ColmapCamera> read_cameras_binary(FileReader& file) {
  const std::uint64_t count = read_count(file, "cameras", kMinCameraBytes);
  std::map<std::uint32_t, ColmapCamera> cameras;
  for (std::uint64_t i = 0; i < count; ++i) {
    file.begin_record("camera", i, count);
    ColmapCamera camera;
    camera.id = file.read<std::uint32_t>();
    const std::string place = detail::concat(file.name(), ": camera ", camera.id);
    camera.model = camera_model_from_id(file.read<std::int32_t>(), place);
    camera.width = file.read<std::uint64_t>();
    camera.height = file.read<std::uint64_t>();
    camera.params.resize(camera_model_param_count(camera.model));
    for (double& value : camera.params) value = file.read<double>();
    add_camera(cameras, std::move(camera), place);
  }
  file.expect_end();
  return cameras;
}

std::vector<ColmapImage> read_images_binary(FileReader& file) {
  const std::uint64_t count = read_count(file, "images", kMinImageBytes);
  std::vector<ColmapImage> images(count);
  for (std::uint64_t i = 0; i < count; ++i) {
    file.begin_record("image", i, count);
    ColmapImage& image = images[i];
    image.id = file.read<std::uint32_t>();
    read_into(file, image.quat);
    read_into(file, image.translation);
    image.camera_id = file.read<std::uint32_t>();
    image.name = file.read_c_string();
    const auto n_points2d = file.read<std::uint64_t>();
    file.expect_records("2D points", n_points2d, kPoint2dBytes);
    file.skip(n_points2d * kPoint2dBytes);
  }
  file.expect_end();
  return images;
}

std::vector<ColmapPoint> read_points_binary(FileReader& file, bool tracks) {
  const std::uint64_t count = read_count(file, "points", kMinPointBytes);
  std::vector<ColmapPoint> points(count);
  for (std::uint64_t i = 0; i < count; ++i) {
    file.begin_record("point", i, count);
    ColmapPoint& point = points[i];
    point.id = file.read<std::uint64_t>();
    read_into(file, point.position);
    for (std::uint8_t& value : point.color) value = file.read<std::uint8_t>();
    point.error = file.read<double>();
    const auto track_length = file.read<std::uint64_t>();
    file.expect_records("track elements", track_length, kTrackElementBytes);
    if (!tracks) {
      file.skip(track_length * kTrackElementBytes);
      continue;
    }
    point.image_ids.resize(track_length);
    for (std::uint32_t& image : point.image_ids) {
      image = file.read<std::uint32_t>();
      file.skip(sizeof(std::uint32_t));  // the index of its 2D point
    }
  }
  file.expect_end();
  return points;
}

std::uint64_t count_images_binary(FileReader& file) {
  return read_count(file, "images", kMinImageBytes);
}

}  // namespace b3dgs::colmap
