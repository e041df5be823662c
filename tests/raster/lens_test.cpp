// Tests Jacobians and Hessians of every lens against finite differences, and projection and its gradient through them.
#include "raster/math/lens.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "core/vec.h"
#include "raster/math/projection.h"
#include "support/finite_difference.h"
#include "support/raster/projection_loss.h"

namespace b3dgs::test {
namespace {

struct LensRow {
  const char* name;
  LensParams<double> lens;
};

LensParams<double> make_lens(LensKind kind, double max_angle, std::vector<double> k) {
  LensParams<double> lens;
  lens.kind = kind;
  lens.max_angle = max_angle * kDegree;
  std::copy(k.begin(), k.end(), lens.k);
  return lens;
}

/// Perspective lenses see less than 90 degrees to the side.
const std::vector<LensRow>& lenses() {
  static const std::vector<LensRow> rows{
      {"full OpenCV", make_lens(LensKind::kDistorted, 89.5,
                                {-0.12, 0.04, -0.005, 0.0003, 0.2, 0.01, 0.02, 0.01, -0.015, 0.006, -0.004})},
      {"FOV", make_lens(LensKind::kFov, 89.5, {1.1})},
      {"division", make_lens(LensKind::kDivision, 89.5, {-0.25})},
      {"EUCM", make_lens(LensKind::kEucm, 89.5, {0.6, 1.1})},
      {"equidistant", make_lens(LensKind::kFisheye, 175, {})},
      {"OpenCV fisheye", make_lens(LensKind::kFisheye, 175, {0.03, -0.012, 0.002, -0.0001})},
      {"thin prism fisheye",
       make_lens(LensKind::kFisheye, 175, {-0.04, 0.01, 0.003, -0.0002, 0, 0, 0, 0.006, -0.008, 0.003, -0.002})},
      {"equirectangular", make_lens(LensKind::kEquirectangular, 0, {})},
  };
  return rows;
}

constexpr LensScale<double> kScale{41, 37, 9.5, 33.25};

struct Place {
  std::string name;
  Vec3<double> point;
};

/// Returns points on the axis and off it at the angles where formulas change, in four directions. For panoramas, also
/// both sides of the seam and points near the poles.
std::vector<Place> places(const LensParams<double>& lens) {
  std::vector<Place> found;
  const auto at = [&](double angle, double azimuth) {
    const double t = 1.7, r = t * std::sin(angle * kDegree);
    found.push_back({std::to_string(angle) + " degrees, azimuth " + std::to_string(azimuth),
                     {r * std::cos(azimuth), r * std::sin(azimuth), t * std::cos(angle * kDegree)}});
  };
  at(0, 0);
  for (const double angle : {0.01, 1.0, 5.0, 5.7, 5.8, 30.0, 60.0, 89.0, 91.0, 120.0, 170.0}) {
    if (angle > 90 && !has_radial_depth(lens)) continue;
    for (const double azimuth : {0.0, 0.6, 2.2, 4.0}) at(angle, azimuth);
  }
  if (lens.kind == LensKind::kEquirectangular) {
    for (const double longitude : {179.9, -179.9, 90.0}) {
      for (const double latitude : {0.0, 40.0, -85.0}) {
        const double h = 2 * std::cos(latitude * kDegree);
        found.push_back(
            {"longitude " + std::to_string(longitude) + ", latitude " + std::to_string(latitude),
             {h * std::sin(longitude * kDegree), 2 * std::sin(latitude * kDegree), h * std::cos(longitude * kDegree)}});
      }
    }
  }
  return found;
}

std::vector<double> list(const Vec3<double>& v) {
  return {v.x, v.y, v.z};
}

/// Returns a step small enough for points near the axis, where the fourth derivatives of a fisheye matter.
double step_at(const Vec3<double>& point) {
  return 3e-4 * std::sqrt(dot(point, point));
}

TEST(Lens, JacobianAgreesWithFiniteDifferences) {
  for (const LensRow& row : lenses()) {
    for (const Place& place : places(row.lens)) {
      SCOPED_TRACE(std::string(row.name) + ", " + place.name);
      const LensPoint<double> seen = lens_point(row.lens, kScale, place.point);
      const auto x = [&](const std::vector<double>& c) {
        const double moved = lens_point<double>(row.lens, kScale, {c[0], c[1], c[2]}).pixel.x;
        if (row.lens.kind != LensKind::kEquirectangular) return moved;
        return seen.pixel.x + std::remainder(moved - seen.pixel.x, 41 * 360 * kDegree);  // across the seam
      };
      const auto y = [&](const std::vector<double>& c) {
        return lens_point<double>(row.lens, kScale, {c[0], c[1], c[2]}).pixel.y;
      };
      EXPECT_TRUE(gradients_agree(list(seen.row_x), numeric_gradient(x, list(place.point), step_at(place.point))));
      EXPECT_TRUE(gradients_agree(list(seen.row_y), numeric_gradient(y, list(place.point), step_at(place.point))));
    }
  }
}

TEST(Lens, HessianAgreesWithFiniteDifferencesOfTheJacobian) {
  const Vec3<double> f{0.7, -1.1, 0.4}, g{-0.3, 0.8, 1.3};
  for (const LensRow& row : lenses()) {
    for (const Place& place : places(row.lens)) {
      SCOPED_TRACE(std::string(row.name) + ", " + place.name);
      const auto value = [&](const std::vector<double>& c) {
        const LensPoint<double> seen = lens_point<double>(row.lens, kScale, {c[0], c[1], c[2]});
        return dot(seen.row_x, f) + dot(seen.row_y, g);
      };
      EXPECT_TRUE(gradients_agree(list(lens_hessian(row.lens, kScale, place.point, f, g)),
                                  numeric_gradient(value, list(place.point), step_at(place.point))));
    }
  }
}

TEST(Lens, ProjectsAsByHand) {
  // 100 degrees to the right of the axis.
  const LensParams<double> fisheye = make_lens(LensKind::kFisheye, 175, {});
  const Vec3<double> right{2 * std::sin(100 * kDegree), 0, 2 * std::cos(100 * kDegree)};
  EXPECT_NEAR(lens_point(fisheye, kScale, right).pixel.x, 9.5 + 41 * 100 * kDegree, 1e-12);
  EXPECT_NEAR(lens_point(fisheye, kScale, right).pixel.y, 33.25, 1e-12);
  EXPECT_NEAR(lens_depth(fisheye, right), 2, 1e-12);
  const LensParams<double> narrow = make_lens(LensKind::kFisheye, 79, {});
  EXPECT_EQ(lens_depth<double>(narrow, {3, 0, 1.5}), 1.5);
  EXPECT_EQ(lens_shrink<double>(narrow, {3, 0, 1.5}, 9), 1);
  EXPECT_EQ(lens_shrink<double>(fisheye, {0, 0, -3}, 1.5), 1);
  EXPECT_EQ(lens_shrink<double>(fisheye, {0, 0, -3}, 3), 0.5);

  const LensParams<double> panorama = make_lens(LensKind::kEquirectangular, 0, {});
  const LensScale<double> scale{360 / (2 * kPi), 180 / kPi, 180, 90};  // 360 x 180 px
  EXPECT_NEAR(lens_point(panorama, scale, {1, 0, 0}).pixel.x, 270, 1e-9);
  EXPECT_NEAR(lens_point(panorama, scale, {0, 1, 1}).pixel.y, 135, 1e-9);

  LensParams<double> distorted = make_lens(LensKind::kDistorted, 80, {0.1});
  EXPECT_NEAR(lens_point(distorted, kScale, {1, 0, 2}).pixel.x, 9.5 + 41 * 0.5 * (1 + 0.1 * 0.25), 1e-12);
}

TEST(Lens, WithoutDistortionIsThePinhole) {
  const LensParams<double> lens = make_lens(LensKind::kDistorted, 80, {});
  const Vec3<double> point{0.5, -0.4, 2};
  const LensPoint<double> seen = lens_point(lens, kScale, point);
  EXPECT_NEAR(seen.pixel.x, 9.5 + 41 * 0.25, 1e-12);
  EXPECT_NEAR(seen.row_x.z, -41 * 0.25 / 2, 1e-12);
}

TEST(Lens, LinearisesBeyondItsLimitAtTheNearestPoint) {
  const LensParams<double> fisheye = make_lens(LensKind::kFisheye, 100, {});
  const Vec3<double> point{0, 3 * std::sin(110 * kDegree), 3 * std::cos(110 * kDegree)};
  const LensPlace<double> place = lens_place(fisheye, point);
  EXPECT_TRUE(place.is_clamped);
  EXPECT_NEAR(place.at.y, 3 * std::sin(100 * kDegree), 1e-12);
  EXPECT_NEAR(place.at.z, 3 * std::cos(100 * kDegree), 1e-12);
  EXPECT_FALSE(is_out_of_lens(fisheye, point));
  EXPECT_TRUE(is_out_of_lens(fisheye, {0, 0.01, -3})) << "it is behind a lens of 200 degrees";

  const LensPlace<double> behind = lens_place<double>(fisheye, {0, 0, -3});
  EXPECT_TRUE(behind.is_clamped);
  EXPECT_NEAR(behind.at.x, 3 * std::sin(100 * kDegree), 1e-12);
  EXPECT_EQ(behind.at.y, 0);

  const LensParams<double> distorted = make_lens(LensKind::kDistorted, 45, {-0.1});
  const LensPlace<double> beside = lens_place<double>(distorted, {3, 0, 2});
  EXPECT_TRUE(beside.is_clamped);
  EXPECT_NEAR(beside.at.x, 2, 1e-12);
  EXPECT_EQ(beside.at.z, 2);

  const LensParams<double> panorama = make_lens(LensKind::kEquirectangular, 0, {});
  const LensPlace<double> pole = lens_place<double>(panorama, {0, -2, 0});
  EXPECT_TRUE(pole.is_clamped);
  EXPECT_NEAR(std::atan2(pole.at.y, std::hypot(pole.at.x, pole.at.z)), -kMaxLatitude * kDegree, 1e-12);
}

TEST(Lens, IsAccurateInSinglePrecision) {
  for (const LensRow& row : lenses()) {
    LensParams<float> lens;
    lens.kind = row.lens.kind;
    for (int i = 0; i < kLensCoefficients; ++i) lens.k[i] = static_cast<float>(row.lens.k[i]);
    LensParams<double> same = row.lens;
    for (int i = 0; i < kLensCoefficients; ++i) same.k[i] = double{lens.k[i]};
    for (const Place& place : places(row.lens)) {
      const bool is_sideways = place.point.z < 0.1;  // where perspective lenses are clamped
      if (is_sideways && !has_radial_depth(row.lens)) continue;
      SCOPED_TRACE(std::string(row.name) + ", " + place.name);
      const Vec3<float> point{static_cast<float>(place.point.x), static_cast<float>(place.point.y),
                              static_cast<float>(place.point.z)};
      const Vec3<float> f{0.7f, -1.1f, 0.4f}, g{-0.3f, 0.8f, 1.3f};
      const Vec3<double> exact =
          lens_hessian<double>(same, kScale, {point.x, point.y, point.z}, {f.x, f.y, f.z}, {g.x, g.y, g.z});
      const Vec3<float> found = lens_hessian<float>(lens, {41, 37, 9.5f, 33.25f}, point, f, g);
      EXPECT_TRUE(gradients_agree({found.x, found.y, found.z}, list(exact), 1e-3));
    }
  }
}

/// Returns the direction that a lens shows at a pixel, near `start`, by Newton's method on the sphere.
Vec3<double> ray_of(const LensParams<double>& lens, double x, double y, Vec3<double> start) {
  for (int i = 0; i < 20; ++i) {
    const LensPoint<double> seen = lens_point(lens, kScale, start);
    double dx = x - seen.pixel.x;
    if (lens.kind == LensKind::kEquirectangular) dx = std::remainder(dx, 41 * 360 * kDegree);  // across the seam
    const double dy = y - seen.pixel.y;
    const double xx = dot(seen.row_x, seen.row_x), xy = dot(seen.row_x, seen.row_y), yy = dot(seen.row_y, seen.row_y);
    const double det = xx * yy - xy * xy;
    start = start + ((yy * dx - xy * dy) / det) * seen.row_x + ((xx * dy - xy * dx) / det) * seen.row_y;
    start = (1 / std::sqrt(dot(start, start))) * start;
  }
  return start;
}

TEST(Lens, SmallGaussiansLookAsAlongExactRays) {
  // Compare the exponent of the projected ellipse with half the least squared Mahalanobis distance along the ray.
  const Shape<double> shape = make_shape<double>({-6.1, -6.6, -7.2}, {0.9, 0.2, -0.3, 0.1});  // up to 0.002 of 1.7
  for (const LensRow& row : lenses()) {
    for (const Place& place : places(row.lens)) {
      const Vec3<double> c = place.point;
      const bool is_sideways = !has_radial_depth(row.lens) && c.z < 0.2;
      if (lens_place(row.lens, c).is_clamped || is_sideways) continue;
      SCOPED_TRACE(std::string(row.name) + ", " + place.name);
      const LensPoint<double> seen = lens_point(row.lens, kScale, c);
      const Vec3<double> a = transpose_times(shape.factor, seen.row_x), b = transpose_times(shape.factor, seen.row_y);
      const double xx = dot(a, a), xy = dot(a, b), yy = dot(b, b), det = xx * yy - xy * xy;
      // Whitened: M^-1 v = S^-1 Q^T v.
      const auto whitened = [&](const Vec3<double>& v) {
        const Vec3<double> turned = transpose_times(shape.rotation, v);
        return Vec3<double>{turned.x / std::exp(-6.1), turned.y / std::exp(-6.6), turned.z / std::exp(-7.2)};
      };
      for (const auto& [u, v] : {std::pair(1.5, 0.3), std::pair(-0.4, 1.2), std::pair(-1.0, -1.0)}) {
        const double dx = u * std::sqrt(xx), dy = v * std::sqrt(yy);
        const double exponent = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / det / 2;
        const Vec3<double> ray = ray_of(row.lens, seen.pixel.x + dx, seen.pixel.y + dy, (1 / std::sqrt(dot(c, c))) * c);
        const Vec3<double> mean = whitened(c), along = whitened(ray);
        const double exact = (dot(mean, mean) - dot(mean, along) * dot(mean, along) / dot(along, along)) / 2;
        EXPECT_NEAR(std::exp(-exponent), std::exp(-exact), 0.02);
      }
    }
  }
}

TEST(Lens, GradientOfTheProjectionAgreesWithFiniteDifferences) {
  PinholeView camera{};
  const Shape<double> turn = make_shape<double>({0, 0, 0}, {0.9, 0.2, -0.3, 0.1});
  for (int i = 0; i < 9; ++i) camera.rotation.m[i] = static_cast<float>(turn.rotation.m[i]);
  camera.fx = 41;
  camera.fy = 37;
  camera.cx = 9.5f;
  camera.cy = 33.25f;
  camera.width = camera.height = 48;
  const auto view = make_view_transform<double>(camera);
  const Mat3<double> factor{{0.1, -0.03, 0.02, 0.05, 0.08, -0.04, -0.03, 0.06, 0.05}};
  int n_clamped = 0;
  std::vector<LensRow> rows = lenses();
  for (const LensRow& row : lenses()) {  // the same with a smaller angle, beyond which points are clamped
    rows.push_back(row);
    rows.back().lens.max_angle *= 0.6;
  }
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const LensRow& row = rows[i];
    for (const Place& place : places(lenses()[i % lenses().size()].lens)) {
      const Vec3<double>& c = place.point;  // on the axis of a lens, a clamped point jumps
      const double off_axis = row.lens.kind == LensKind::kEquirectangular ? std::hypot(c.x, c.z) : std::hypot(c.x, c.y);
      if (lens_place(row.lens, c).is_clamped && off_axis < 0.01) continue;
      n_clamped += lens_place(row.lens, c).is_clamped;
      SCOPED_TRACE(std::string(row.name) + ", " + place.name);
      const Projection<double> p = project_gaussian(view, row.lens, place.point, factor);
      const ProjectionLoss loss(p);
      const ProjectionGrad<double> grad = loss.gradient(view, row.lens, place.point, factor);
      const auto of_point = [&](const std::vector<double>& c) {
        const Vec3<double> point{c[0], c[1], c[2]};
        return loss(project_gaussian(view, row.lens, point, factor), lens_depth(row.lens, point));
      };
      EXPECT_TRUE(gradients_agree(list(grad.point), numeric_gradient(of_point, list(place.point), 1e-4)));
      const auto of_factor = [&](const std::vector<double>& m) {
        Mat3<double> moved;
        std::copy(m.begin(), m.end(), moved.m);
        return loss(project_gaussian(view, row.lens, place.point, moved), lens_depth(row.lens, place.point));
      };
      EXPECT_TRUE(gradients_agree({grad.factor.m, grad.factor.m + 9},
                                  numeric_gradient(of_factor, {factor.m, factor.m + 9}, 1e-4)));
    }
  }
  EXPECT_GE(n_clamped, 50);
}

}  // namespace
}  // namespace b3dgs::test
