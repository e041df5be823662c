// COLMAP sparse models (https://colmap.github.io/format.html): cameras, images and points as stored in files.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"

namespace b3dgs {

class FileReader;

/// COLMAP's camera models by ID. Values without a name here are in the table in camera_models.cpp.
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
  kSimpleDivision = 12,
  kDivision = 13,
  kSimpleFisheye = 14,
  kFisheye = 15,
  kEucm = 16,
  kEquirectangular = 17,
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
  std::string name;         // relative to the image folder, '/' between folders
  std::string points_2d{};  // with Observations::kAll: the 2D points as in the file
};

struct ColmapPoint {
  std::uint64_t id = 0;
  std::array<double, 3> position{};
  std::array<std::uint8_t, 3> color{};
  double error = 0;                        // px
  std::vector<std::uint32_t> image_ids{};  // with Observations::kTracks: images in which COLMAP saw it
  std::string track{};                     // with Observations::kAll: the track as in the file
};

/// An image of a model whose pose or camera cannot be used.
struct LeftOutImage {
  std::string name, reason;
};

/// Which 2D points and tracks to read. They are written empty, except with kAll, which keeps those of a file for a file
/// of the same format.
enum class Observations { kNone, kTracks, kAll };

struct ColmapModel {
  std::map<std::uint32_t, ColmapCamera> cameras;
  std::vector<ColmapImage> images;
  std::vector<ColmapPoint> points;
  std::vector<LeftOutImage> left_out{};  // not in `images`
  std::string left_out_points{};         // a warning about points whose positions cannot be used, or ""
};

/// Returns the name as COLMAP writes it ("SIMPLE_RADIAL"), and its parameters in order ("f, cx, cy, k").
const char* camera_model_name(CameraModel model);
const char* camera_model_params(CameraModel model);
int camera_model_param_count(CameraModel model);

/// Returns the models whose photographs can be used.
std::vector<CameraModel> supported_camera_models();

/// Returns the model with COLMAP's id or name. @throws InputError, beginning with `place`, if its parameters are
/// unknown
CameraModel camera_model_from_id(int id, const std::string& place);
CameraModel camera_model_from_name(const std::string& name, const std::string& place);

/// Returns the camera with its lens, without a pose and the lens's largest angle (native_camera()). @throws InputError,
/// beginning with `place`, for impossible intrinsics or panorama sizes
Camera camera_of(const ColmapCamera& named, const std::string& place);

/// Returns the camera for COLMAP's files, with ID 0. Its parameters begin with two focal lengths if the model has any.
ColmapCamera to_colmap_camera(const Camera& camera);

enum class ColmapFormat { kBinary, kText };

/// Returns the format of the model in a folder, binary if it exists in both formats, or nothing if there is no model.
/// One of the three files may be missing.
std::optional<ColmapFormat> colmap_format(const std::filesystem::path& folder);

/// Returns the number of registered images without reading the rest of the model. @throws InputError
std::uint64_t count_colmap_images(const std::filesystem::path& folder);

/// Reads cameras, images and points3D from one folder in its colmap_format(). Ignores other files, such as the rigs and
/// frames of newer versions of COLMAP. Leaves out images with an impossible pose or camera, such as NaN, and points
/// with an impossible position. If there is no file of points in this format, reads one in the other format. Without
/// `needs_points`, it may be missing. @throws InputError if no image or no point is left, or with the file, the record
/// or line, the expected and the found value
ColmapModel read_colmap_model(const std::filesystem::path& folder, Observations observations = Observations::kNone,
                              bool needs_points = true);

/// Does the same from open files.
struct ColmapFiles {
  FileReader &cameras, &images, &points;
  std::optional<ColmapFormat> point_format{};  // if it differs from that of the others
};
ColmapModel read_colmap_model(const ColmapFiles& files, ColmapFormat format,
                              Observations observations = Observations::kNone);

/// Writes a model folder that COLMAP can read. @throws IoError
void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model, ColmapFormat format);

/// Maps x to scale * rotation * x + translation.
struct Similarity {
  double scale = 1;
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row-major
  std::array<double, 3> translation{};

  std::array<double, 3> operator()(const std::array<double, 3>& x) const;
};

/// Returns the centre of the camera, in world coordinates.
std::array<double, 3> center_of(const ColmapImage& image);

/// Applies a similarity to the world coordinates of the model.
void transform(const Similarity& to_new, ColmapModel& model);

struct SparseModelFolder {
  std::filesystem::path folder;
  std::vector<std::string> notes;  // which model was chosen, and errors of others
};

/// Returns whether the scene folder contains a COLMAP model, complete or not.
bool has_model_folder(const std::filesystem::path& source);

/// Searches sparse/N, sparse/ and the scene folder itself. If there are several models, chooses the one with the most
/// images. @throws InputError if there is none
SparseModelFolder find_model_folder(const std::filesystem::path& source);

}  // namespace b3dgs
