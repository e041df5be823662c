#include "scene/transforms/transforms.h"

#include <algorithm>
#include <cmath>

#include "core/vec.h"

namespace b3dgs::transforms {
namespace {

constexpr double kMaxNumber = 1e12;   // its square is finite in single precision
constexpr double kMaxSide = 1 << 20;  // px; larger only in damaged files

constexpr const char* kPanorama = "EQUIRECTANGULAR";

bool is_fisheye(const FrameValues& values, const std::string& model) {
  // COLMAP's names, which nerfstudio writes too.
  constexpr std::array kModels{"SIMPLE_PINHOLE", "PINHOLE",        "SIMPLE_RADIAL",         "RADIAL",        "OPENCV",
                               "FULL_OPENCV",    "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"};
  if (model.empty()) return values.boolean("is_fisheye");
  if (std::find(kModels.begin(), kModels.end(), model) != kModels.end()) {
    return model.find("FISHEYE") != std::string::npos;
  }
  std::string names = kModels[0];
  for (std::size_t i = 1; i < kModels.size(); ++i) names += std::string(", ") + kModels[i];
  input_error(values.place(), ": unsupported camera_model \"", model.substr(0, 40), "\", expected one of ", names,
              " and ", kPanorama, "; convert the photographs to perspective views first");
}

// fx and fy, in px.
std::array<double, 2> focal_lengths(const FrameValues& values, ImageSize size) {
  const auto from_angle = [&](const char* key, int side) -> std::optional<double> {
    const std::optional<double> angle = values.number(key);
    if (!angle) return std::nullopt;
    if (!(*angle > 0 && *angle < kPi)) {
      input_error(values.place(), ": expected ", key, " above 0 and below pi (radians), found ", *angle);
    }
    return 0.5 * side / std::tan(0.5 * *angle);
  };
  std::optional<double> fx = values.number("fl_x"), fy = values.number("fl_y");
  if (!fx && !fy) {
    fx = from_angle("camera_angle_x", size.width);
    fy = from_angle("camera_angle_y", size.height);
  }
  if (!fx && !fy) {
    input_error(values.place(), ": expected a focal length as fl_x (px) or camera_angle_x (radians), found neither");
  }
  return {fx.value_or(fy.value_or(0)), fy.value_or(fx.value_or(0))};
}

}  // namespace

double finite_number(const Json& json, const std::string& what, const std::string& place) {
  const double value = json.is_number() ? json.get<double>() : kMaxNumber * 2;
  if (!(std::abs(value) <= kMaxNumber)) {
    input_error(place, ": expected ", what, " to be a number of at most ", kMaxNumber, ", found ", json_excerpt(json));
  }
  return value;
}

const Json* FrameValues::find(const char* key) const {
  for (const Json* json : {&frame_, &file_}) {
    const auto found = json->find(key);
    if (found != json->end() && !found->is_null()) return &*found;
  }
  return nullptr;
}

std::optional<double> FrameValues::number(const char* key) const {
  const Json* json = find(key);
  if (json == nullptr) return std::nullopt;
  return finite_number(*json, key, place_);
}

std::optional<int> FrameValues::side(const char* key) const {
  const std::optional<double> value = number(key);
  if (!value) return std::nullopt;
  if (*value != std::floor(*value) || *value < 1 || *value > kMaxSide) {
    input_error(place_, ": expected ", key, " to be a whole number of 1 to ", kMaxSide, " px, found ", *value);
  }
  return static_cast<int>(*value);
}

bool FrameValues::boolean(const char* key) const {
  const Json* json = find(key);
  if (json != nullptr && !json->is_boolean()) {
    input_error(place_, ": expected ", key, " to be true or false, found ", json_excerpt(*json));
  }
  return json != nullptr && json->get<bool>();
}

std::string FrameValues::text(const char* key) const {
  const Json* json = find(key);
  if (json == nullptr) return "";
  if (!json->is_string()) input_error(place_, ": expected ", key, " to be a text, found ", json_excerpt(*json));
  return json->get<std::string>();
}

std::optional<ColmapCamera> camera_of_frame(const FrameValues& values,
                                            const std::function<std::optional<ImageSize>()>& size_of_photograph) {
  const std::optional<int> w = values.side("w"), h = values.side("h");
  std::optional<ImageSize> size;
  if (w && h) size = ImageSize{*w, *h};
  if (!size) size = size_of_photograph();
  if (!size) return std::nullopt;

  const std::string model = values.text("camera_model");
  ColmapCamera camera;
  camera.width = static_cast<std::uint64_t>(size->width);
  camera.height = static_cast<std::uint64_t>(size->height);
  if (model == kPanorama) {
    camera.model = CameraModel::kEquirectangular;
    camera.params = {static_cast<double>(size->width), static_cast<double>(size->height)};
    camera_of(camera, values.place());  // checks the size
    return camera;
  }
  const bool is_fisheye_camera = is_fisheye(values, model);
  const auto [fx, fy] = focal_lengths(values, *size);
  camera.params = {fx, fy, values.number("cx").value_or(0.5 * size->width),
                   values.number("cy").value_or(0.5 * size->height)};
  const auto append = [&](CameraModel of_coefficients, std::initializer_list<double> coefficients) {
    camera.model = of_coefficients;
    camera.params.insert(camera.params.end(), coefficients.begin(), coefficients.end());
  };
  const double k1 = values.coefficient("k1"), k2 = values.coefficient("k2"), k3 = values.coefficient("k3"),
               k4 = values.coefficient("k4"), k5 = values.coefficient("k5"), k6 = values.coefficient("k6"),
               p1 = values.coefficient("p1"), p2 = values.coefficient("p2");
  if (is_fisheye_camera) {
    append(CameraModel::kOpenCvFisheye, {k1, k2, k3, k4});
  } else if (model == "FULL_OPENCV") {
    append(CameraModel::kFullOpenCv, {k1, k2, p1, p2, k3, k4, k5, k6});
  } else if (k4 != 0 || k5 != 0 || k6 != 0) {
    // Programs do not agree whether k4 multiplies r^8 or divides by 1 + k4 r^2.
    input_error(values.place(), ": k4 to k6 of a perspective camera need the camera_model FULL_OPENCV, found ",
                model.empty() ? "none" : model, " and k4 ", k4);
  } else if (k3 != 0) {
    append(CameraModel::kFullOpenCv, {k1, k2, p1, p2, k3, 0, 0, 0});
  } else if (k1 != 0 || k2 != 0 || p1 != 0 || p2 != 0) {
    append(CameraModel::kOpenCv, {k1, k2, p1, p2});
  } else {
    append(CameraModel::kPinhole, {});
  }
  camera_of(camera, values.place());  // checks focal lengths and principal point
  return camera;
}

}  // namespace b3dgs::transforms
