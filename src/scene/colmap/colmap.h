// COLMAP sparse models as they are on disk: the vocabulary that reader and writer share.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

/// COLMAP's camera models by id (src/colmap/sensor/models.h there): 0-10 are the classic ones.
enum class CameraModel : int {
  kSimplePinhole = 0,
  kPinhole = 1,
  kSimpleRadial = 2,
  kRadial = 3,
  kOpenCv = 4,
  kOpenCvFisheye = 5,
  kFullOpenCv = 6,
  kFov = 7,
  kSimpleRadialFisheye = 8,
  kRadialFisheye = 9,
  kThinPrismFisheye = 10,
};

struct ColmapCamera {
  std::uint32_t id = 0;
  CameraModel model = CameraModel::kPinhole;
  std::uint64_t width = 0, height = 0;  // px
  std::vector<double> params;           // in COLMAP's order for the model
};

struct ColmapImage {
  std::uint32_t id = 0;
  std::array<double, 4> quat{1, 0, 0, 0};  // cam_from_world, w x y z
  std::array<double, 3> translation{};     // cam_from_world
  std::uint32_t camera_id = 0;
  std::string name;  // relative to the image folder, '/' between folders
};

struct ColmapPoint {
  std::uint64_t id = 0;
  std::array<double, 3> position{};
  std::array<std::uint8_t, 3> color{};
  double error = 0;  // px
};

/// 2D observations and tracks are skipped on reading and written empty: training does not need them.
struct ColmapModel {
  std::map<std::uint32_t, ColmapCamera> cameras;
  std::vector<ColmapImage> images;
  std::vector<ColmapPoint> points;
};

/// Name as COLMAP writes it ("SIMPLE_RADIAL"), and its parameters in order ("f, cx, cy, k").
const char* camera_model_name(CameraModel model);
const char* camera_model_params(CameraModel model);
int camera_model_param_count(CameraModel model);

/// Model by COLMAP's number or name. @throws InputError with the remedy, beginning with `place`, if it is none of 0-10.
CameraModel camera_model_from_id(int id, const std::string& place);
CameraModel camera_model_from_name(const std::string& name, const std::string& place);
/// @throws InputError that says the model is not supported, and the remedy.
[[noreturn]] void refuse_camera_model(const std::string& place, const std::string& model);

enum class ColmapFormat { kBinary, kText };

/// Format of the model in a folder, binary if it is there in both; nothing if the folder holds no model. One of the
/// three files may be missing: reading then says which.
std::optional<ColmapFormat> colmap_format(const std::filesystem::path& folder);

/// Number of registered images, without reading the rest of the model. @throws InputError
std::uint64_t count_colmap_images(const std::filesystem::path& folder);

/// Reads cameras, images and points3D (.bin, or .txt where they are not all there as .bin) of one folder. Other files,
/// such as the rigs and frames of newer versions, are not read.
/// @throws InputError naming file, record or line, what was expected and what was found.
ColmapModel read_colmap_model(const std::filesystem::path& folder);

/// Writes a model folder that COLMAP reads. @throws IoError
void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model, ColmapFormat format);

}  // namespace b3dgs
