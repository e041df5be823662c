// COLMAP's camera models as a table, and conversion of cameras to and from them.
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "scene/cameras/camera_lens.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

struct CameraModelRow {
  const char* name;
  const char* params;  // "f, cx, cy, ...", "fx, fy, cx, cy, ..." or "w, h"; null: the model is not supported
  LensKind kind;
  std::array<std::uint8_t, 8> places;  // index in LensParams::k of each coefficient after cy
};

// In the order of COLMAP's ids (src/colmap/sensor/models.h there). RAD_TAN_THIN_PRISM_FISHEYE has only a name, because
// its number of parameters has changed between versions of COLMAP.
constexpr std::array<CameraModelRow, 18> kCameraModels{{
    {"SIMPLE_PINHOLE", "f, cx, cy", LensKind::kPinhole, {}},
    {"PINHOLE", "fx, fy, cx, cy", LensKind::kPinhole, {}},
    {"SIMPLE_RADIAL", "f, cx, cy, k", LensKind::kDistorted, {0}},
    {"RADIAL", "f, cx, cy, k1, k2", LensKind::kDistorted, {0, 1}},
    {"OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2", LensKind::kDistorted, {0, 1, 7, 8}},
    {"OPENCV_FISHEYE", "fx, fy, cx, cy, k1, k2, k3, k4", LensKind::kFisheye, {0, 1, 2, 3}},
    {"FULL_OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6", LensKind::kDistorted, {0, 1, 7, 8, 2, 4, 5, 6}},
    {"FOV", "fx, fy, cx, cy, omega", LensKind::kFov, {0}},
    {"SIMPLE_RADIAL_FISHEYE", "f, cx, cy, k", LensKind::kFisheye, {0}},
    {"RADIAL_FISHEYE", "f, cx, cy, k1, k2", LensKind::kFisheye, {0, 1}},
    {"THIN_PRISM_FISHEYE",
     "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1",
     LensKind::kFisheye,
     {0, 1, 7, 8, 2, 3, 9, 10}},
    {"RAD_TAN_THIN_PRISM_FISHEYE", nullptr, LensKind::kFisheye, {}},
    {"SIMPLE_DIVISION", "f, cx, cy, k", LensKind::kDivision, {0}},
    {"DIVISION", "fx, fy, cx, cy, k", LensKind::kDivision, {0}},
    {"SIMPLE_FISHEYE", "f, cx, cy", LensKind::kFisheye, {}},
    {"FISHEYE", "fx, fy, cx, cy", LensKind::kFisheye, {}},
    {"EUCM", "fx, fy, cx, cy, alpha, beta", LensKind::kEucm, {0, 1}},
    {"EQUIRECTANGULAR", "w, h", LensKind::kEquirectangular, {}},
}};
static_assert(static_cast<int>(CameraModel::kThinPrismFisheye) == 10, "the table is in the order of the ids");

// Limit of the focal length or principal point, divided by the longer side of the image. It is larger than for any
// lens, and finite in single precision.
constexpr double kMaxRatio = 1e6;

const CameraModelRow& row_of(CameraModel model) {
  const int id = static_cast<int>(model);
  B3DGS_CHECK(id >= 0 && id < static_cast<int>(kCameraModels.size()) && kCameraModels[id].params, "camera model ", id);
  return kCameraModels[id];
}

void check_intrinsics(const Camera& camera, const std::string& place) {
  const double side = std::max(camera.width, camera.height);
  const auto [shorter, longer] = std::minmax(camera.fx, camera.fy);
  if (!(shorter >= side / kMaxRatio && longer <= side * kMaxRatio)) {
    input_error(place, ": expected focal lengths above 0 that a lens can have for images of ", camera.width, " x ",
                camera.height, " px, found ", camera.fx, " and ", camera.fy, " px; reconstruct the scene again");
  }
  if (!(std::max(std::abs(camera.cx), std::abs(camera.cy)) <= side * kMaxRatio)) {
    input_error(place, ": impossible principal point at (", camera.cx, ", ", camera.cy, ") px for images of ",
                camera.width, " x ", camera.height, " px; reconstruct the scene again");
  }
}

}  // namespace

const char* camera_model_name(CameraModel model) {
  return row_of(model).name;
}

const char* camera_model_params(CameraModel model) {
  return row_of(model).params;
}

int camera_model_param_count(CameraModel model) {
  const std::string params = row_of(model).params;
  return 1 + static_cast<int>(std::count(params.begin(), params.end(), ','));
}

std::vector<CameraModel> supported_camera_models() {
  std::vector<CameraModel> models;
  for (std::size_t id = 0; id < kCameraModels.size(); ++id) {
    if (kCameraModels[id].params) models.push_back(static_cast<CameraModel>(id));
  }
  return models;
}

CameraModel camera_model_from_id(int id, const std::string& place) {
  if (id < 0 || id >= static_cast<int>(kCameraModels.size())) {
    input_error(place, ": unknown camera model ", id, ", expected 0 (SIMPLE_PINHOLE) to ", kCameraModels.size() - 1,
                " (", kCameraModels.back().name, "); the file is damaged or from a newer COLMAP");
  }
  if (kCameraModels[id].params) return static_cast<CameraModel>(id);
  std::string names;
  for (const CameraModel model : supported_camera_models()) {
    names += detail::concat(names.empty() ? "" : ", ", camera_model_name(model));
  }
  input_error(place, ": unsupported camera model ", kCameraModels[id].name, " (", id, "), expected one of ", names,
              "; run \"colmap image_undistorter\" and train on its output");
}

CameraModel camera_model_from_name(const std::string& name, const std::string& place) {
  for (std::size_t id = 0; id < kCameraModels.size(); ++id) {
    if (name == kCameraModels[id].name) return camera_model_from_id(static_cast<int>(id), place);
  }
  input_error(place, ": unknown camera model \"", name, "\", expected a name such as PINHOLE or OPENCV");
}

Camera camera_of(const ColmapCamera& named, const std::string& place) {
  const CameraModelRow& row = row_of(named.model);
  const std::vector<double>& p = named.params;
  B3DGS_CHECK(p.size() == static_cast<std::size_t>(camera_model_param_count(named.model)), place, ": ", p.size(),
              " camera parameters");
  const auto width = static_cast<int>(named.width), height = static_cast<int>(named.height);
  if (row.kind == LensKind::kEquirectangular) {
    if (width != 2 * height || p[0] != width || p[1] != height) {
      input_error(place, ": expected a panorama of 360 x 180 degrees, twice as wide as high, found ", width, " x ",
                  height, " px and the parameters ", p[0], " x ", p[1], "; crop or scale it, and name its size");
    }
    return panorama_camera({width, height});
  }
  const std::size_t n_focal_lengths = std::string(row.params).rfind("fx", 0) == 0 ? 2 : 1, first = n_focal_lengths + 2;
  Camera camera{width, height, p[0], p[n_focal_lengths - 1], p[first - 2], p[first - 1], {}, {}};
  bool is_distorted = row.kind == LensKind::kFisheye;  // without coefficients, it is the equidistant projection
  for (std::size_t i = first; i < p.size(); ++i) {
    camera.lens.k[row.places[i - first]] = p[i];
    is_distorted = is_distorted || p[i] != 0;
  }
  if (is_distorted) camera.lens.kind = row.kind;
  check_intrinsics(camera, place);
  return camera;
}

ColmapCamera to_colmap_camera(const Camera& camera) {
  // For each LensKind, the model that has all its coefficients.
  constexpr std::array<CameraModel, 7> kModels{
      CameraModel::kPinhole,        CameraModel::kFullOpenCv, CameraModel::kFov,
      CameraModel::kDivision,       CameraModel::kEucm,       CameraModel::kThinPrismFisheye,
      CameraModel::kEquirectangular};
  static_assert(kModels.size() == static_cast<std::size_t>(LensKind::kEquirectangular) + 1, "one for each kind");
  ColmapCamera named;
  named.model = kModels[static_cast<std::size_t>(camera.lens.kind)];
  named.width = static_cast<std::uint64_t>(camera.width);
  named.height = static_cast<std::uint64_t>(camera.height);
  if (named.model == CameraModel::kEquirectangular) {
    named.params = {static_cast<double>(camera.width), static_cast<double>(camera.height)};
    return named;
  }
  named.params = {camera.fx, camera.fy, camera.cx, camera.cy};
  const auto n_coefficients = static_cast<std::size_t>(camera_model_param_count(named.model)) - named.params.size();
  for (std::size_t i = 0; i < n_coefficients; ++i) {
    named.params.push_back(camera.lens.k[row_of(named.model).places[i]]);
  }
  return named;
}

}  // namespace b3dgs
