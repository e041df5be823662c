#include "raster/math/projection.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "support/finite_difference.h"
#include "support/raster/projection_loss.h"

namespace b3dgs {
namespace {

using test::gradients_agree;
using test::numeric_gradient;

/// Makes a rotated, translated view with an off-centre principal point: x/z from -0.23 to 0.94, y/z from -0.9 to 0.34.
PinholeView turned_view() {
  const Shape<double> shape = make_shape<double>({0, 0, 0}, {0.9, 0.2, -0.3, 0.1});
  PinholeView view{};
  for (int i = 0; i < 9; ++i) view.rotation.m[i] = static_cast<float>(shape.rotation.m[i]);
  view.translation = {0.3f, -0.2f, 0.5f};
  view.fx = 41;
  view.fy = 37;
  view.cx = 9.5f;
  view.cy = 33.25f;
  view.width = 48;
  view.height = 46;
  return view;
}

const Mat3<double> kFactor{{0.4, -0.1, 0.05, 0.2, 0.3, -0.15, -0.1, 0.25, 0.2}};

struct Place {
  const char* name;
  Vec3<double> point;  // camera frame
  bool x_clamped, y_clamped;
};
const std::vector<Place> kPlaces{
    {"inside", {0.5, -0.4, 2.0}, false, false},
    {"beside the image, not clamped", {2.1, 0.1, 2.0}, false, false},
    {"far to the right", {3.0, 0.1, 2.0}, true, false},
    {"far to the left", {-1.5, 0.1, 2.0}, true, false},
    {"far above", {0.1, -4.0, 2.5}, false, true},
    {"far below", {0.1, 2.0, 2.5}, false, true},
    {"far off the corner", {-3.0, 4.0, 1.5}, true, true},
};

TEST(Projection, ProjectsOnTheAxisAsByHand) {
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = 10;
  view.fy = 20;
  view.cx = 4;
  view.cy = 3;
  view.width = 8;
  view.height = 6;
  const auto p = project_gaussian<double>(make_view_transform<double>(view), Pinhole{}, {0, 0, 2},
                                          {{0.4, 0, 0, 0, 0.3, 0, 0, 0, 9}});
  EXPECT_EQ(p.mean2d.x, 4);
  EXPECT_EQ(p.mean2d.y, 3);
  EXPECT_NEAR(p.cov.xx, 4 + 0.3, 1e-7);  // (10 / 2 * 0.4)^2 plus the blur
  EXPECT_NEAR(p.cov.xy, 0, 1e-7);
  EXPECT_NEAR(p.cov.yy, 9 + 0.3, 1e-7);
  EXPECT_NEAR(p.conic.xx, 1 / 4.3, 1e-8);
  EXPECT_NEAR(largest_sigma(p.cov), std::sqrt(9.3), 1e-8);
}

TEST(Projection, ClampsTheSlopeAtTheExtendedImage) {
  const auto view = make_view_transform<double>(turned_view());
  EXPECT_NEAR(view.x_min, -9.5 / 41 - 0.3 * 24 / 41, 1e-7);
  EXPECT_NEAR(view.x_max, 38.5 / 41 + 0.3 * 24 / 41, 1e-7);
  EXPECT_NEAR(view.y_min, -33.25 / 37 - 0.3 * 23 / 37, 1e-7);
  EXPECT_NEAR(view.y_max, 12.75 / 37 + 0.3 * 23 / 37, 1e-7);
  for (const Place& place : kPlaces) {
    const auto p = project_gaussian(view, Pinhole{}, place.point, kFactor);
    EXPECT_EQ(p.slope_x_clamped, place.x_clamped) << place.name;
    EXPECT_EQ(p.slope_y_clamped, place.y_clamped) << place.name;
    EXPECT_NEAR(p.mean2d.x, 41 * place.point.x / place.point.z + 9.5, 1e-12) << "the centre itself is not clamped";
  }
}

TEST(Projection, CovarianceIsThatOfTheJacobianTimesTheRotatedShape) {
  const PinholeView camera = turned_view();
  const auto view = make_view_transform<double>(camera);
  for (const Place& place : kPlaces) {
    const auto p = project_gaussian(view, Pinhole{}, place.point, kFactor);
    const double z = place.point.z;
    const double u = std::min(std::max(place.point.x / z, view.x_min), view.x_max);
    const double v = std::min(std::max(place.point.y / z, view.y_min), view.y_max);
    const double jacobian[2][3] = {{41 / z, 0, -41 * u / z}, {0, 37 / z, -37 * v / z}};
    double spread[2][3] = {};  // J R M
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 3; ++j) {
        for (int k = 0; k < 3; ++k) {
          for (int l = 0; l < 3; ++l) spread[i][j] += jacobian[i][k] * view.rotation(k, l) * kFactor(l, j);
        }
      }
    }
    const auto product = [&](int i, int j) {
      return spread[i][0] * spread[j][0] + spread[i][1] * spread[j][1] + spread[i][2] * spread[j][2];
    };
    const double size = product(0, 0) + product(1, 1);
    EXPECT_NEAR(p.cov.xx, product(0, 0) + 0.3, 1e-12 * size + 1e-7) << place.name;
    EXPECT_NEAR(p.cov.xy, product(0, 1), 1e-12 * size) << place.name;
    EXPECT_NEAR(p.cov.yy, product(1, 1) + 0.3, 1e-12 * size + 1e-7) << place.name;
    EXPECT_NEAR(p.det, p.cov.xx * p.cov.yy - p.cov.xy * p.cov.xy, 1e-12 * size * size) << place.name;
    EXPECT_NEAR(p.conic.xx * p.cov.xx + p.conic.xy * p.cov.xy, 1, 1e-12) << place.name;
    EXPECT_NEAR(p.conic.xx * p.cov.xy + p.conic.xy * p.cov.yy, 0, 1e-12) << place.name;
    EXPECT_NEAR(p.conic.xy * p.cov.xy + p.conic.yy * p.cov.yy, 1, 1e-12) << place.name;
  }
}

TEST(Projection, KeepsTheDeterminantOfANeedleInSinglePrecision) {
  // 3000 px long at 45 degrees and thinner than the blur. xx yy and xy^2 agree to their last bit, and their difference
  // is 0.3 times the variance along the long axis.
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = view.fy = 1000;
  view.cx = view.cy = 500;
  view.width = view.height = 1000;
  const float a = 3 * std::sqrt(0.5f);
  const auto p =
      project_gaussian<float>(make_view_transform<float>(view), Pinhole{}, {0, 0, 1}, {{a, 0, 0, a, 0, 0, 0, 0, 0}});
  EXPECT_NEAR(p.det / (0.3 * (9e6 + 0.3)), 1, 1e-5);
}

TEST(Projection, GradientAgreesWithFiniteDifferences) {
  const auto view = make_view_transform<double>(turned_view());
  for (const Place& place : kPlaces) {
    SCOPED_TRACE(place.name);
    const Projection<double> p = project_gaussian(view, Pinhole{}, place.point, kFactor);
    const test::ProjectionLoss loss(p);
    const ProjectionGrad<double> grad = loss.gradient(view, Pinhole{}, place.point, kFactor);

    const auto of_point = [&](const std::vector<double>& x) {
      return loss(project_gaussian(view, Pinhole{}, {x[0], x[1], x[2]}, kFactor), x[2]);
    };
    EXPECT_TRUE(gradients_agree({grad.point.x, grad.point.y, grad.point.z},
                                numeric_gradient(of_point, {place.point.x, place.point.y, place.point.z})));

    const auto of_factor = [&](const std::vector<double>& m) {
      Mat3<double> factor;
      for (int i = 0; i < 9; ++i) factor.m[i] = m[static_cast<std::size_t>(i)];
      return loss(project_gaussian(view, Pinhole{}, place.point, factor), place.point.z);
    };
    EXPECT_TRUE(
        gradients_agree({grad.factor.m, grad.factor.m + 9}, numeric_gradient(of_factor, {kFactor.m, kFactor.m + 9})));

    const auto of_mean2d = [&](const std::vector<double>& x) {
      Projection<double> moved = p;
      moved.mean2d = {x[0], x[1]};
      return loss(moved, place.point.z);
    };
    EXPECT_TRUE(gradients_agree({grad.mean2d.x, grad.mean2d.y}, numeric_gradient(of_mean2d, {p.mean2d.x, p.mean2d.y})));
  }
}

TEST(Projection, GradientByWorldParametersAgreesWithFiniteDifferences) {
  // The whole chain, in the order of the backward pass: mean, log scales, quaternion.
  const auto view = make_view_transform<double>(turned_view());
  const std::vector<double> x{0.4, -0.3, 2.2, -1.2, -0.5, -2.0, 0.5, -0.8, 0.3, 0.4};
  const auto projected = [&](const std::vector<double>& at, Vec3<double>* point, Shape<double>* shape) {
    *point = to_camera<double>(view, {at[0], at[1], at[2]});
    *shape = make_shape<double>({at[3], at[4], at[5]}, {at[6], at[7], at[8], at[9]});
    return project_gaussian(view, Pinhole{}, *point, shape->factor);
  };
  Vec3<double> point;
  Shape<double> shape;
  const Projection<double> p = projected(x, &point, &shape);
  const test::ProjectionLoss loss(p);
  const ProjectionGrad<double> grad = loss.gradient(view, Pinhole{}, point, shape.factor);
  const Vec3<double> mean = transpose_times(view.rotation, grad.point);
  const ShapeGrad<double> of_shape = shape_backward(shape, grad.factor);

  const auto value = [&](const std::vector<double>& at) {
    Vec3<double> moved;
    Shape<double> moved_shape;
    const Projection<double> moved_projection = projected(at, &moved, &moved_shape);
    return loss(moved_projection, moved.z);
  };
  EXPECT_TRUE(
      gradients_agree({mean.x, mean.y, mean.z, of_shape.log_scales.x, of_shape.log_scales.y, of_shape.log_scales.z,
                       of_shape.quat.x, of_shape.quat.y, of_shape.quat.z, of_shape.quat.w},
                      numeric_gradient(value, x)));
}

}  // namespace
}  // namespace b3dgs
