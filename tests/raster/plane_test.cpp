// Tests the planes of splats: against the peaks of the Gaussian along rays, through every lens, and in extreme shapes.
#include "raster/math/plane.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

namespace b3dgs {
namespace {

using Vec = Vec3<double>;

/// A Gaussian in the camera frame.
struct Gaussian {
  Vec center, log_scales;
  Mat3<double> axes;  // columns

  Gaussian(Vec center, Vec scales, Vec4<double> quat)
      : center(center),
        log_scales{std::log(scales.x), std::log(scales.y), std::log(scales.z)},
        axes(make_shape<double>({0, 0, 0}, quat).rotation) {}
  /// Returns the inverse covariance times a vector.
  Vec inverse_times(Vec v) const {
    const Vec y = transpose_times(axes, v);
    return axes *
           Vec{y.x * std::exp(-2 * log_scales.x), y.y * std::exp(-2 * log_scales.y), y.z * std::exp(-2 * log_scales.z)};
  }
  /// Returns t where the density is largest along t ray.
  double peak(Vec ray) const { return dot(ray, inverse_times(center)) / dot(ray, inverse_times(ray)); }
  SplatPlane<double> plane(double depth) const { return splat_plane(center, depth, axes, log_scales); }
};

const std::vector<Gaussian>& gaussians() {
  static const std::vector<Gaussian> all{
      {{0.2, -0.3, 2}, {0.3, 0.2, 0.05}, {0.9, 0.2, -0.3, 0.1}},     // a disc
      {{-0.7, 0.4, 1.5}, {0.02, 0.03, 0.4}, {0.3, -0.8, 0.2, 0.5}},  // a needle
      {{0.1, 0.1, 3}, {0.2, 0.2, 0.2}, {1, 0, 0, 0}},                // a ball
      {{1.5, -1, 1}, {0.1, 0.2, 0.004}, {0.1, 0.7, 0.6, -0.2}},      // thin, far from the axis
  };
  return all;
}

TEST(Plane, ContainsTheCentreAndFacesTheCamera) {
  for (const Gaussian& g : gaussians()) {
    const SplatPlane<double> plane = g.plane(g.center.z);
    EXPECT_NEAR(dot(plane.m, g.center), 1, 1e-12);
    EXPECT_NEAR(dot(plane.normal, plane.normal), 1, 1e-12);
    EXPECT_LT(dot(plane.normal, g.center), 0);
    EXPECT_NEAR(dot(cross(plane.m, plane.normal), cross(plane.m, plane.normal)), 0, 1e-20) << "parallel";
  }
}

TEST(Plane, IsThatOfThePeaksToFirstOrder) {
  for (const Gaussian& g : gaussians()) {
    const Vec r0 = (1 / g.center.z) * g.center, m = g.plane(g.center.z).m;
    EXPECT_NEAR(g.peak(r0), g.center.z, 1e-12);
    for (const Vec& step : {Vec{1, 0, 0}, Vec{0, 1, 0}, Vec{0.6, -0.8, 0}}) {
      const auto error = [&](double h) { return std::abs(1 / g.peak(r0 + h * step) - dot(m, r0 + h * step)); };
      const double most = dot(m, m);  // bounds the second derivative of the error up to a factor
      EXPECT_LT(error(1e-3), 1e-4 * most);
      EXPECT_LT(error(1e-4), 0.011 * error(1e-3) + 1e-14) << "falls with the square of the step";
    }
  }
}

TEST(Plane, OfAFlatSplatHasItsThinAxis) {
  const Gaussian flat({0.2, -0.3, 2}, {0.3, 0.2, 1e-5}, {0.9, 0.2, -0.3, 0.1});
  const Vec normal = flat.plane(2).normal, thin{flat.axes(0, 2), flat.axes(1, 2), flat.axes(2, 2)};
  EXPECT_NEAR(std::abs(dot(normal, thin)), 1, 1e-9);
}

TEST(Plane, SharpnessIsThatOfTheGaussianAlongTheRay) {
  for (const Gaussian& g : gaussians()) {
    const Vec r0 = (1 / g.center.z) * g.center, beyond = 0.01 * r0;
    EXPECT_NEAR(g.plane(g.center.z).sharpness * 0.01 * 0.01, dot(beyond, g.inverse_times(beyond)) / 2, 1e-12);
  }
}

bool is_finite(Vec v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

TEST(Plane, ExtremeShapesStayFinite) {
  const Mat3<float> eye{{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  for (const float thin : {-300.0f, -120.0f, -40.0f, -3.0f}) {
    for (const float thick : {-3.0f, 0.0f, 40.0f}) {
      for (const Vec3f& scales : {Vec3f{thin, thick, thick}, Vec3f{thick, thick, thin}, Vec3f{thin, thin, thick},
                                  Vec3f{thick, thin, thin}, Vec3f{thin, thin, thin}, Vec3f{thick, thick, thick}}) {
        for (const Vec3f& center : {Vec3f{0, 0, 2}, Vec3f{0, 1e5f, 0.2f}, Vec3f{1e-9f, 0, 1e12f}}) {
          const SplatPlane<float> plane = splat_plane(center, center.z, eye, scales);
          EXPECT_TRUE(is_finite({plane.m.x, plane.m.y, plane.m.z}));
          EXPECT_NEAR(dot(plane.normal, plane.normal), 1, 1e-5);
          EXPECT_NEAR(dot(plane.m, center), 1, 1e-4);
          EXPECT_FALSE(std::isnan(plane.sharpness));
        }
      }
    }
  }
  // Seen exactly from its edge, a disc has no plane that the ray crosses. It faces the camera.
  const SplatPlane<float> edge = splat_plane(Vec3f{0, 0, 2}, 2.0f, eye, Vec3f{-60, 0, 0});
  EXPECT_EQ(edge.normal.z, -1);
  EXPECT_EQ(edge.m.z, 0.5f);
}

PinholeView wide_view() {
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = 41;
  view.fy = 37;
  view.cx = 9.5f;
  view.cy = 33.25f;
  view.width = 48;
  view.height = 46;
  return view;
}

LensParams<double> make_lens(LensKind kind, double max_angle, std::vector<double> k) {
  LensParams<double> lens;
  lens.kind = kind;
  lens.max_angle = max_angle * kDegree;
  std::copy(k.begin(), k.end(), lens.k);
  return lens;
}

/// Compares the slope with points of the plane near the centre.
template <class Lens, class PixelOf>
void expect_slope_of_plane(const Lens& lens, Vec center, PixelOf&& pixel_of) {
  const ViewTransform<double> view = make_view_transform<double>(wide_view());
  const double depth = lens_depth(lens, center);
  const Gaussian g(center, {0.3, 0.2, 0.05}, {0.9, 0.2, -0.3, 0.1});
  const SplatPlane<double> plane = g.plane(depth);
  EXPECT_NEAR(dot(plane.m, center), 1, 1e-12);
  const Vec2<double> slope = plane_slope(view, lens, center, depth, plane.m), mean = pixel_of(center);
  const Vec along = cross(plane.normal, {0.3, -0.5, 0.8});
  for (const Vec& step : {along, cross(plane.normal, along)}) {
    const auto error = [&](double h) {
      const Vec at = center + h * step;
      const Vec2<double> pixel = pixel_of(at);
      return std::abs(1 / lens_depth(lens, at) - 1 / depth - slope.x * (pixel.x - mean.x) -
                      slope.y * (pixel.y - mean.y));
    };
    EXPECT_LT(error(1e-4), 1e-6);
    EXPECT_LT(error(1e-5), 0.011 * error(1e-4) + 1e-13) << "falls with the square of the step";
  }
}

TEST(Plane, InverseDepthIsLinearInThePixelOfAPinhole) {
  const ViewTransform<double> view = make_view_transform<double>(wide_view());
  for (const Gaussian& g : gaussians()) {
    const SplatPlane<double> plane = g.plane(g.center.z);
    const Vec2<double> slope = plane_slope(view, Pinhole{}, g.center, g.center.z, plane.m);
    for (const Vec& ray : {Vec{0.5, -0.4, 1}, Vec{-2, 1, 1}}) {
      const double dx = view.fx * (ray.x - g.center.x / g.center.z), dy = view.fy * (ray.y - g.center.y / g.center.z);
      EXPECT_NEAR(1 / g.center.z + slope.x * dx + slope.y * dy, dot(plane.m, ray), 1e-12);
    }
  }
}

TEST(Plane, SlopeIsThatOfThePlaneThroughEveryLens) {
  const std::vector<LensParams<double>> lenses{
      make_lens(LensKind::kDistorted, 89.5,
                {-0.12, 0.04, -0.005, 0.0003, 0.2, 0.01, 0.02, 0.01, -0.015, 0.006, -0.004}),
      make_lens(LensKind::kFov, 89.5, {1.1}),
      make_lens(LensKind::kDivision, 89.5, {-0.25}),
      make_lens(LensKind::kEucm, 89.5, {0.6, 1.1}),
      make_lens(LensKind::kFisheye, 60, {0.03, -0.012, 0.002, -0.0001}),  // depth along the axis
      make_lens(LensKind::kFisheye, 175, {}),                             // distance
      make_lens(LensKind::kEquirectangular, 0, {}),
  };
  const ViewTransform<double> view = make_view_transform<double>(wide_view());
  for (const LensParams<double>& lens : lenses) {
    SCOPED_TRACE(testing::Message() << "lens " << static_cast<int>(lens.kind) << ", " << lens.max_angle);
    const auto pixel_of = [&](Vec at) { return lens_point(lens, view, at).pixel; };
    expect_slope_of_plane(lens, {0.2, -0.3, 2}, pixel_of);
    expect_slope_of_plane(lens, {1.1, 0.7, 1.5}, pixel_of);
    if (has_radial_depth(lens)) expect_slope_of_plane(lens, {1.2, 0.6, -0.7}, pixel_of);  // behind the camera
  }
}

TEST(Plane, RowsHoldDepthsOrInverseDepths) {
  const float mean[3]{0.2f, -0.3f, 2}, log_scales[3]{-1, -2, -4}, quat[4]{1.8f, 0.4f, -0.6f, 0.2f}, filter = 0.5f;
  GaussianArrays arrays{1};
  arrays.means = mean;
  arrays.log_scales = log_scales;
  arrays.quats = quat;
  const auto view = make_view_transform<float>(wide_view());
  const PlaneRow surface = plane_row<false>(arrays, 0, view, Pinhole{}, DepthKind::kSurface);
  EXPECT_FLOAT_EQ(surface.value, 0.5f);
  EXPECT_GT(std::abs(surface.slope_x) + std::abs(surface.slope_y), 1e-3f);
  EXPECT_LT(surface.normal.z, 0);
  const PlaneRow mean_row = plane_row<false>(arrays, 0, view, Pinhole{}, DepthKind::kMean);
  EXPECT_FLOAT_EQ(mean_row.value, 2);
  EXPECT_EQ(mean_row.slope_x, 0);
  EXPECT_EQ(mean_row.slope_y, 0);
  EXPECT_EQ(mean_row.variance, surface.variance);
  arrays.filters = &filter;  // rounder, so its normal is nearer to the ray and it is thicker
  const PlaneRow smooth = plane_row<true>(arrays, 0, view, Pinhole{}, DepthKind::kSurface);
  EXPECT_LT(std::abs(smooth.slope_x) + std::abs(smooth.slope_y), std::abs(surface.slope_x) + std::abs(surface.slope_y));
  EXPECT_GT(smooth.variance, 2 * surface.variance);
  EXPECT_EQ(plane_row<false>(arrays, 0, view, Pinhole{}, DepthKind::kSurface).variance, surface.variance);
}

}  // namespace
}  // namespace b3dgs
