#include "scene/cameras/lens.h"

#include <algorithm>

namespace b3dgs {

bool Lens::is_pinhole() const {
  return model->is_pinhole_at_zero &&
         std::all_of(coefficients.begin(), coefficients.end(), [](double value) { return value == 0; });
}

Lens Lens::scaled(double sx, double sy) const {
  Lens scaled = *this;
  scaled.fx *= sx;
  scaled.cx *= sx;
  scaled.fy *= sy;
  scaled.cy *= sy;
  return scaled;
}

Camera Lens::pinhole(ImageSize size) const {
  return {size.width, size.height, fx, fy, cx, cy, {}};
}

std::array<double, 2> distort(const Lens& lens, double x, double y) {
  return lens.model->distort(lens.coefficients.data(), x, y);
}

double monotonic_radius(const Lens& lens, double limit) {
  // Steps far smaller than a pixel of an image whose corner is at `limit`; a turning point between two steps moves the
  // result by less than one step.
  constexpr int kSteps = 1 << 15;
  double before = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = limit * i / kSteps;
    const double distorted = r * lens.model->radial_factor(lens.coefficients.data(), r);
    if (!(distorted > before)) return limit * (i - 1) / kSteps;
    before = distorted;
  }
  return limit;
}

}  // namespace b3dgs
