// Test support: a function of a projection, and its gradient by project_backward().
#pragma once

#include <vector>

#include "raster/math/projection.h"

namespace b3dgs::test {

/// Sum over a few pixels of q * ln(alpha), plus the depth. project_backward() computes the gradient of this function.
struct ProjectionLoss {
  std::vector<Vec3<double>> pixels;  // x, y in px and q
  double depth_weight = 0.4;

  explicit ProjectionLoss(const Projection<double>& p) {
    const double x = p.mean2d.x, y = p.mean2d.y, size = largest_sigma(p.cov);
    pixels = {{x + 0.7 * size, y - 0.4 * size, 0.9},
              {x - 1.1 * size, y + 0.3 * size, -0.6},
              {x + 0.2 * size, y + 1.3 * size, 1.4}};
  }
  double operator()(const Projection<double>& p, double depth) const {
    double sum = depth_weight * depth;
    for (const Vec3<double>& pixel : pixels) {
      const double dx = pixel.x - p.mean2d.x, dy = pixel.y - p.mean2d.y;
      sum -= pixel.z * 0.5 * (p.conic.xx * dx * dx + 2 * p.conic.xy * dx * dy + p.conic.yy * dy * dy);
    }
    return sum;
  }
  template <class Lens>
  ProjectionGrad<double> gradient(const ViewTransform<double>& view, const Lens& lens, Vec3<double> point,
                                  const Mat3<double>& factor) const {
    const Projection<double> p = project_gaussian(view, lens, point, factor);
    Vec2<double> grad_mean{0, 0};
    Sym2<double> grad_cov{0, 0, 0};
    for (const Vec3<double>& pixel : pixels) {
      const double dx = pixel.x - p.mean2d.x, dy = pixel.y - p.mean2d.y;
      const double x = kConicScale * (p.conic.xx * dx + p.conic.xy * dy);
      const double y = kConicScale * (p.conic.xy * dx + p.conic.yy * dy);
      grad_mean = {grad_mean.x + pixel.z * x, grad_mean.y + pixel.z * y};
      grad_cov = {grad_cov.xx + pixel.z * x * x, grad_cov.xy + pixel.z * x * y, grad_cov.yy + pixel.z * y * y};
    }
    return project_backward(view, lens, point, factor, p, grad_mean, spread_grad(p, grad_cov), depth_weight);
  }
};

}  // namespace b3dgs::test
