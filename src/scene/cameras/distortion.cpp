#include "scene/cameras/distortion.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace b3dgs {
namespace {

// Focal length or principal point to the longer side of the image: beyond any lens, and finite in single precision.
constexpr double kMaxRatio = 1e6;

// 1 + c0 s + c1 s^2 + ...
template <std::size_t N>
double polynomial(const std::array<double, N>& coefficients, double s) {
  double sum = 0;
  for (std::size_t i = N; i-- > 0;) sum = (sum + coefficients[i]) * s;
  return 1 + sum;
}

// Distorted radius divided by the undistorted one.
double radial_factor(const Lens& lens, double r) {
  if (!lens.is_fisheye) return polynomial(lens.radial, r * r) / polynomial(lens.denominator, r * r);
  const double theta = std::atan(r);
  return (r > 1e-12 ? theta / r : 1.0) * polynomial(lens.radial, theta * theta);
}

}  // namespace

bool Lens::is_pinhole() const {
  const auto is_zero = [](double value) { return value == 0; };
  return !is_fisheye && p1 == 0 && p2 == 0 && std::all_of(radial.begin(), radial.end(), is_zero) &&
         std::all_of(denominator.begin(), denominator.end(), is_zero);
}

Lens Lens::scaled(double sx, double sy) const {
  Lens scaled = *this;
  scaled.fx *= sx;
  scaled.cx *= sx;
  scaled.fy *= sy;
  scaled.cy *= sy;
  return scaled;
}

Lens lens_of(const ColmapCamera& camera, const std::string& place) {
  const std::vector<double>& p = camera.params;
  B3DGS_CHECK(p.size() == static_cast<std::size_t>(camera_model_param_count(camera.model)), place, ": ", p.size(),
              " camera parameters");
  Lens lens;
  const auto one_focal_length = [&] {
    lens.fx = lens.fy = p[0];
    lens.cx = p[1];
    lens.cy = p[2];
  };
  const auto two_focal_lengths = [&] {
    lens.fx = p[0];
    lens.fy = p[1];
    lens.cx = p[2];
    lens.cy = p[3];
  };
  switch (camera.model) {
    case CameraModel::kSimplePinhole:
      one_focal_length();
      break;
    case CameraModel::kPinhole:
      two_focal_lengths();
      break;
    case CameraModel::kSimpleRadialFisheye:
    case CameraModel::kSimpleRadial:
      one_focal_length();
      lens.radial[0] = p[3];
      break;
    case CameraModel::kRadialFisheye:
    case CameraModel::kRadial:
      one_focal_length();
      lens.radial = {p[3], p[4]};
      break;
    case CameraModel::kOpenCvFisheye:
      two_focal_lengths();
      lens.radial = {p[4], p[5], p[6], p[7]};
      break;
    case CameraModel::kOpenCv:
    case CameraModel::kFullOpenCv:
      two_focal_lengths();
      lens.radial = {p[4], p[5]};
      lens.p1 = p[6];
      lens.p2 = p[7];
      if (camera.model == CameraModel::kFullOpenCv) {
        lens.radial[2] = p[8];
        lens.denominator = {p[9], p[10], p[11]};
      }
      break;
    case CameraModel::kFov:
    case CameraModel::kThinPrismFisheye:
      refuse_camera_model(place, camera_model_name(camera.model));
  }
  lens.is_fisheye = camera.model == CameraModel::kOpenCvFisheye || camera.model == CameraModel::kRadialFisheye ||
                    camera.model == CameraModel::kSimpleRadialFisheye;
  if (!(lens.fx > 0 && lens.fy > 0)) {
    input_error(place, ": expected focal lengths above 0, found ", lens.fx, " and ", lens.fy,
                "; reconstruct the scene again");
  }
  const double side = static_cast<double>(std::max(camera.width, camera.height));
  const auto [shorter, longer] = std::minmax(lens.fx, lens.fy);
  if (shorter < side / kMaxRatio || longer > side * kMaxRatio) {
    input_error(place, ": has the focal lengths ", lens.fx, " and ", lens.fy, " px for images of ", camera.width, " x ",
                camera.height, "; reconstruct the scene again");
  }
  if (std::max(std::abs(lens.cx), std::abs(lens.cy)) > side * kMaxRatio) {
    input_error(place, ": has its principal point at (", lens.cx, ", ", lens.cy, ") px in images of ", camera.width,
                " x ", camera.height, "; reconstruct the scene again");
  }
  return lens;
}

std::array<double, 2> distort(const Lens& lens, double x, double y) {
  const double r2 = x * x + y * y;
  const double factor = radial_factor(lens, std::sqrt(r2));
  return {x * factor + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
          y * factor + 2 * lens.p2 * x * y + lens.p1 * (r2 + 2 * y * y)};
}

double monotonic_radius(const Lens& lens, double limit) {
  // Steps far finer than a pixel of any image that is limited by `limit`; a turning point between two steps moves the
  // result by less than one.
  constexpr int kSteps = 1 << 15;
  double before = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = limit * i / kSteps;
    const double distorted = r * radial_factor(lens, r);
    if (!(distorted > before)) return limit * (i - 1) / kSteps;
    before = distorted;
  }
  return limit;
}

}  // namespace b3dgs
