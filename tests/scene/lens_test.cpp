#include "scene/cameras/camera_lens.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/check.h"
#include "scene/colmap/colmap.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using test::fails_with;

Camera camera(CameraModel model, std::vector<double> params) {
  return camera_of({1, model, 100, 100, std::move(params)}, "camera 1");
}

LensParams<double> lens(CameraModel model, std::vector<double> params) {
  return camera(model, std::move(params)).lens;
}

TEST(Distortion, SimpleRadialByHand) {
  const auto [x, y] = distort(lens(CameraModel::kSimpleRadial, {10, 5, 5, 0.1}), 0.3, 0.4);  // r^2 = 0.25
  EXPECT_DOUBLE_EQ(x, 0.3 * 1.025);
  EXPECT_DOUBLE_EQ(y, 0.4 * 1.025);
}

TEST(Distortion, RadialByHand) {
  const auto [x, y] = distort(lens(CameraModel::kRadial, {10, 5, 5, 0.1, -0.2}), 0.3, 0.4);
  EXPECT_DOUBLE_EQ(x, 0.3 * (1 + 0.025 - 0.2 * 0.0625));
  EXPECT_DOUBLE_EQ(y, 0.4 * (1 + 0.025 - 0.2 * 0.0625));
}

TEST(Distortion, OpenCvByHand) {
  // Tangential: 2 p1 x y + p2 (r^2 + 2 x^2) and 2 p2 x y + p1 (r^2 + 2 y^2).
  const auto [x, y] = distort(lens(CameraModel::kOpenCv, {10, 11, 5, 6, 0.1, -0.2, 0.01, 0.03}), 0.3, 0.4);
  EXPECT_NEAR(x, 0.3 * 1.0125 + 0.02 * 0.12 + 0.03 * (0.25 + 0.18), 1e-15);
  EXPECT_NEAR(y, 0.4 * 1.0125 + 0.06 * 0.12 + 0.01 * (0.25 + 0.32), 1e-15);
}

TEST(Distortion, FullOpenCvByHand) {
  const LensParams<double> full =
      lens(CameraModel::kFullOpenCv, {10, 11, 5, 6, 0.1, -0.2, 0.01, 0.03, 0.5, 0.2, 0.3, -0.4});
  const auto [x, y] = distort(full, 0.3, 0.4);
  const double radial =
      (1 + 0.1 * 0.25 - 0.2 * 0.0625 + 0.5 * 0.015625) / (1 + 0.2 * 0.25 + 0.3 * 0.0625 - 0.4 * 0.015625);
  EXPECT_NEAR(x, 0.3 * radial + 0.02 * 0.12 + 0.03 * 0.43, 1e-15);
  EXPECT_NEAR(y, 0.4 * radial + 0.06 * 0.12 + 0.01 * 0.57, 1e-15);
}

TEST(Distortion, FisheyesByHand) {
  const double theta = M_PI / 4, t2 = theta * theta;  // at radius 1
  const auto at_one = [](const LensParams<double>& l) { return distort(l, 0, 1)[1]; };
  EXPECT_DOUBLE_EQ(at_one(lens(CameraModel::kSimpleRadialFisheye, {10, 5, 5, 0})), theta);
  EXPECT_DOUBLE_EQ(at_one(lens(CameraModel::kSimpleRadialFisheye, {10, 5, 5, 0.1})), theta * (1 + 0.1 * t2));
  EXPECT_DOUBLE_EQ(at_one(lens(CameraModel::kRadialFisheye, {10, 5, 5, 0.1, 0.2})),
                   theta * (1 + 0.1 * t2 + 0.2 * t2 * t2));
  EXPECT_NEAR(at_one(lens(CameraModel::kOpenCvFisheye, {10, 11, 5, 6, 0.1, 0.2, 0.3, 0.4})),
              theta * (1 + 0.1 * t2 + 0.2 * t2 * t2 + 0.3 * std::pow(t2, 3) + 0.4 * std::pow(t2, 4)), 1e-15);
}

TEST(Distortion, ThinPrismFisheyeByHand) {
  const LensParams<double> l =
      lens(CameraModel::kThinPrismFisheye, {10, 11, 5, 6, 0.1, -0.2, 0.01, 0.03, 0.5, 0.4, 0.02, -0.05});
  const auto [x, y] = distort(l, 0.3, 0.4);
  const double theta = std::atan(0.5), t2 = theta * theta;
  const double u = 0.3 * theta / 0.5, v = 0.4 * theta / 0.5;
  const double radial = 0.1 * t2 - 0.2 * t2 * t2 + 0.5 * std::pow(t2, 3) + 0.4 * std::pow(t2, 4);
  EXPECT_NEAR(x, u + u * radial + 2 * 0.01 * u * v + 0.03 * (t2 + 2 * u * u) + 0.02 * t2, 1e-15);
  EXPECT_NEAR(y, v + v * radial + 2 * 0.03 * u * v + 0.01 * (t2 + 2 * v * v) - 0.05 * t2, 1e-15);
  EXPECT_EQ(distort(l, 0, 0)[0], 0);
}

TEST(Distortion, FovByHand) {
  const auto [x, y] = distort(lens(CameraModel::kFov, {10, 11, 5, 6, 0.9}), 0.3, 0.4);
  const double radius = std::atan(2 * 0.5 * std::tan(0.45)) / 0.9;
  EXPECT_NEAR(x, 0.3 * radius / 0.5, 1e-15);
  EXPECT_NEAR(y, 0.4 * radius / 0.5, 1e-15);
  EXPECT_TRUE(camera(CameraModel::kFov, {10, 11, 5, 6, 0}).is_pinhole());
  // There is no jump near omega = 0 and near the axis.
  EXPECT_NEAR(distort(lens(CameraModel::kFov, {10, 11, 5, 6, 1e-7}), 0.3, 0.4)[0], 0.3, 1e-12);
  EXPECT_NEAR(distort(lens(CameraModel::kFov, {10, 11, 5, 6, 0.9}), 1e-13, 0)[0], 1e-13 * 2 * std::tan(0.45) / 0.9,
              1e-25);
}

// The distorted radius s of the division model satisfies r = s / (1 + k s^2).
TEST(Distortion, DivisionByHand) {
  for (const double k : {-0.3, 0.2}) {
    const auto [x, y] = distort(lens(CameraModel::kSimpleDivision, {10, 5, 6, k}), 0.3, 0.4);
    const double s = std::hypot(x, y);
    EXPECT_NEAR(s / (1 + k * s * s), 0.5, 1e-15) << k;
    EXPECT_NEAR(x / y, 0.75, 1e-15);
    EXPECT_EQ(distort(lens(CameraModel::kDivision, {10, 11, 5, 6, k}), 0.3, 0.4)[0], x);
    EXPECT_EQ(s > 0.5, k > 0) << "as of radial distortion with the same k";
  }
  // With k > 0, nothing is visible beyond r = 1 / sqrt(4 k).
  EXPECT_NEAR(monotonic_radius(lens(CameraModel::kSimpleDivision, {10, 5, 6, 0.25}), 2), 1, 1e-3);
}

TEST(Distortion, EucmByHand) {
  const auto [x, y] = distort(lens(CameraModel::kEucm, {10, 11, 5, 6, 0.6, 1.2}), 0.3, 0.4);
  const double depth = 0.6 * std::sqrt(1.2 * 0.25 + 1) + 0.4;
  EXPECT_NEAR(x, 0.3 / depth, 1e-15);
  EXPECT_NEAR(y, 0.4 / depth, 1e-15);
}

TEST(Distortion, FisheyesWithoutCoefficientsAreEquidistant) {
  const double theta = std::atan(0.5);
  EXPECT_DOUBLE_EQ(distort(lens(CameraModel::kSimpleFisheye, {10, 5, 6}), 0.3, 0.4)[0], 0.6 * theta);
  EXPECT_DOUBLE_EQ(distort(lens(CameraModel::kFisheye, {10, 11, 5, 6}), 0.3, 0.4)[1], 0.8 * theta);
  EXPECT_FALSE(camera(CameraModel::kFisheye, {10, 11, 5, 6}).is_pinhole());
}

// Holds for every entry of the table of camera models, also for new ones.
TEST(Distortion, OfEverySupportedModelIsConsistent) {
  ASSERT_GE(supported_camera_models().size(), 9u);
  for (const CameraModel model : supported_camera_models()) {
    if (model == CameraModel::kEquirectangular) continue;  // is not a pinhole
    SCOPED_TRACE(camera_model_name(model));
    std::vector<double> params(static_cast<std::size_t>(camera_model_param_count(model)), 0);
    const bool has_two_focal_lengths = std::string(camera_model_params(model)).rfind("fx", 0) == 0;
    const std::size_t first = has_two_focal_lengths ? 4 : 3;
    params[0] = params[has_two_focal_lengths ? 1 : 0] = 100;
    if (params.size() > first) params[first] = 0.05;     // k1: no tangential distortion
    if (model == CameraModel::kEucm) params.back() = 1;  // alone, its first coefficient does not distort
    const Camera found = camera(model, params);
    const auto [axis_x, axis_y] = distort(found.lens, 0, 0);
    EXPECT_EQ(axis_x, 0);
    EXPECT_EQ(axis_y, 0);
    const double r = std::sqrt(0.7 * 0.7 + 0.4 * 0.4), factor = distort(found.lens, r, 0)[0] / r;
    const auto [x, y] = distort(found.lens, 0.7, 0.4);
    EXPECT_NEAR(x, 0.7 * factor, 1e-15);
    EXPECT_NEAR(y, 0.4 * factor, 1e-15);
    const bool is_pinhole = model == CameraModel::kSimplePinhole || model == CameraModel::kPinhole;
    EXPECT_EQ(found.is_pinhole(), is_pinhole);
    EXPECT_EQ(factor == 1, is_pinhole);
    EXPECT_GT(monotonic_radius(found.lens, 0.5), 0.49);
  }
}

TEST(Distortion, KeepsTheOpticalAxisFixed) {
  for (const double x : {0.0, 1e-300, 1e-15}) {
    const auto [xd, yd] = distort(lens(CameraModel::kOpenCvFisheye, {10, 11, 5, 6, 0.1, 0.2, 0.3, 0.4}), x, 0);
    EXPECT_DOUBLE_EQ(xd, x);
    EXPECT_EQ(yd, 0);
  }
}

TEST(Distortion, ModelsWithoutCoefficientsArePinholesButFisheyesAreNot) {
  EXPECT_TRUE(camera(CameraModel::kSimplePinhole, {10, 5, 5}).is_pinhole());
  EXPECT_TRUE(camera(CameraModel::kPinhole, {10, 11, 5, 5}).is_pinhole());
  EXPECT_TRUE(camera(CameraModel::kFullOpenCv, {10, 11, 5, 5, 0, 0, 0, 0, 0, 0, 0, 0}).is_pinhole());
  EXPECT_FALSE(camera(CameraModel::kFullOpenCv, {10, 11, 5, 5, 0, 0, 0, 0, 0, 0, 0, 1e-3}).is_pinhole());
  EXPECT_FALSE(camera(CameraModel::kOpenCv, {10, 11, 5, 5, 0, 0, 0, 1e-4}).is_pinhole());
  EXPECT_FALSE(camera(CameraModel::kSimpleRadialFisheye, {10, 5, 5, 0}).is_pinhole());
}

TEST(Distortion, TakesFocalLengthsAndPrincipalPointInColmapsOrder) {
  const Camera one = camera(CameraModel::kRadial, {10, 5, 6, 0, 0}),
               two = camera(CameraModel::kOpenCv, {10, 11, 5, 6, 0, 0, 0, 0});
  EXPECT_EQ((std::array<double, 4>{one.fx, one.fy, one.cx, one.cy}), (std::array<double, 4>{10, 10, 5, 6}));
  EXPECT_EQ((std::array<double, 4>{two.fx, two.fy, two.cx, two.cy}), (std::array<double, 4>{10, 11, 5, 6}));
}

TEST(Distortion, NamesUnsupportedModels) {
  EXPECT_TRUE(fails_with<InputError>({"cameras.txt", "INVENTED", "expected a name such as"},
                                     [] { camera_model_from_name("INVENTED", "cameras.txt"); }));
  EXPECT_TRUE(fails_with<InputError>({"cameras.txt", "RAD_TAN_THIN_PRISM_FISHEYE", "image_undistorter"},
                                     [] { camera_model_from_name("RAD_TAN_THIN_PRISM_FISHEYE", "cameras.txt"); }));
}

TEST(Distortion, RejectsFocalLengthsThatAreNotPositive) {
  EXPECT_TRUE(fails_with<InputError>({"camera 1", "focal lengths", "-10"}, [] {
    camera(CameraModel::kPinhole, {10, -10, 5, 5});
  }));
}

TEST(Distortion, MonotonicRadiusIsWhereTheDerivativeVanishes) {
  // r - r^3 / 2 grows up to r^2 = 2/3.
  EXPECT_NEAR(monotonic_radius(lens(CameraModel::kSimpleRadial, {10, 5, 5, -0.5}), 2), std::sqrt(2.0 / 3.0), 1e-4);
  EXPECT_EQ(monotonic_radius(lens(CameraModel::kSimpleRadial, {10, 5, 5, 0.5}), 2), 2);
  EXPECT_EQ(monotonic_radius(lens(CameraModel::kSimpleRadial, {10, 5, 5, -0.5}), 0.5), 0.5);
  // theta - theta^3 / 3 grows up to theta = 1.
  EXPECT_NEAR(monotonic_radius(lens(CameraModel::kSimpleRadialFisheye, {10, 5, 5, -1.0 / 3.0}), 3), std::tan(1.0),
              1e-3);
}

TEST(CameraOf, RejectsImpossibleIntrinsics) {
  const auto refuses = [](std::vector<double> params, const std::string& part) {
    const ColmapCamera named{1, CameraModel::kPinhole, 64, 48, std::move(params)};
    return test::fails_with<InputError>({"place", part}, [&] { camera_of(named, "place"); });
  };
  EXPECT_TRUE(refuses({0, 50, 32, 24}, "focal lengths above 0"));
  EXPECT_TRUE(refuses({50, -50, 32, 24}, "focal lengths above 0"));
  EXPECT_TRUE(refuses({1e300, 50, 32, 24}, "1e+300"));
  EXPECT_TRUE(refuses({1e-300, 50, 32, 24}, "1e-300"));
  EXPECT_TRUE(refuses({50, 50, 32, -1e200}, "principal point at (32, -1e+200)"));
}

}  // namespace
}  // namespace b3dgs
