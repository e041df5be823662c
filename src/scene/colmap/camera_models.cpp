// COLMAP's camera models as a table.
#include <algorithm>
#include <array>

#include "core/check.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

struct CameraModelRow {
  const char* name;
  const char* params;  // null: the model is known by name only, its cameras cannot be read
};

// By id. The newer models have had different numbers of parameters over time, so they are only named.
constexpr std::array<CameraModelRow, 18> kCameraModels{{
    {"SIMPLE_PINHOLE", "f, cx, cy"},
    {"PINHOLE", "fx, fy, cx, cy"},
    {"SIMPLE_RADIAL", "f, cx, cy, k"},
    {"RADIAL", "f, cx, cy, k1, k2"},
    {"OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2"},
    {"OPENCV_FISHEYE", "fx, fy, cx, cy, k1, k2, k3, k4"},
    {"FULL_OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6"},
    {"FOV", "fx, fy, cx, cy, omega"},
    {"SIMPLE_RADIAL_FISHEYE", "f, cx, cy, k"},
    {"RADIAL_FISHEYE", "f, cx, cy, k1, k2"},
    {"THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1"},
    {"RAD_TAN_THIN_PRISM_FISHEYE", nullptr},
    {"SIMPLE_DIVISION", nullptr},
    {"DIVISION", nullptr},
    {"SIMPLE_FISHEYE", nullptr},
    {"FISHEYE", nullptr},
    {"EUCM", nullptr},
    {"EQUIRECTANGULAR", nullptr},
}};
static_assert(static_cast<int>(CameraModel::kThinPrismFisheye) == 10, "the table is in the order of the ids");

const CameraModelRow& row_of(CameraModel model) {
  const int id = static_cast<int>(model);
  B3DGS_CHECK(id >= 0 && id < static_cast<int>(kCameraModels.size()) && kCameraModels[id].params, "camera model ", id);
  return kCameraModels[id];
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

void refuse_camera_model(const std::string& place, const std::string& model) {
  input_error(place, ": the camera model ", model,
              " is not supported; expected a pinhole, radial, OPENCV or fisheye model of COLMAP: run \"colmap "
              "image_undistorter\" first and train on its output");
}

CameraModel camera_model_from_id(int id, const std::string& place) {
  if (id < 0 || id >= static_cast<int>(kCameraModels.size())) {
    input_error(place, ": unknown camera model ", id, ", expected 0 (SIMPLE_PINHOLE) to ", kCameraModels.size() - 1,
                " (", kCameraModels.back().name, "); the file is damaged or from a newer COLMAP");
  }
  if (!kCameraModels[id].params) refuse_camera_model(place, detail::concat(kCameraModels[id].name, " (", id, ")"));
  return static_cast<CameraModel>(id);
}

CameraModel camera_model_from_name(const std::string& name, const std::string& place) {
  for (std::size_t id = 0; id < kCameraModels.size(); ++id) {
    if (name == kCameraModels[id].name) return camera_model_from_id(static_cast<int>(id), place);
  }
  input_error(place, ": unknown camera model \"", name, "\", expected a name such as PINHOLE or OPENCV");
}

}  // namespace b3dgs
