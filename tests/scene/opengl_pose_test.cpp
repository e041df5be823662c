#include "scene/cameras/camera.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "core/check.h"

namespace b3dgs {
namespace {

const OpenGlMatrix kIdentity{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

std::array<double, 3> to_camera(const Pose& pose, const std::array<double, 3>& world) {
  std::array<double, 3> point = pose.translation;
  for (int row = 0; row < 3; ++row) {
    for (int k = 0; k < 3; ++k) point[row] += pose.rotation[3 * row + k] * world[k];
  }
  return point;
}

std::string error_of(const OpenGlMatrix& matrix) {
  try {
    pose_from_opengl(matrix, "transforms.json: frame 3");
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(OpenGlPose, CameraLooksAlongMinusZWithYUp) {
  OpenGlMatrix matrix = kIdentity;
  matrix[3] = 10, matrix[7] = 20, matrix[11] = 30;  // the camera's centre
  const Pose pose = pose_from_opengl(matrix);
  // A point to the right of, above and in front of the camera has +x, -y, +z in the frame of this program.
  const std::array<double, 3> point = to_camera(pose, {10 + 1, 20 + 2, 30 - 3});
  EXPECT_NEAR(point[0], 1, 1e-14);
  EXPECT_NEAR(point[1], -2, 1e-14);
  EXPECT_NEAR(point[2], 3, 1e-14);
}

TEST(OpenGlPose, TheTwoFunctionsAreInverseAndDropAUniformScale) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 100; ++i) {
    Pose pose;
    pose.rotation = rotation_from_quaternion({normal(random), normal(random), normal(random), normal(random)});
    pose.translation = {normal(random), normal(random), normal(random)};
    OpenGlMatrix matrix = opengl_from_pose(pose);
    for (const double scale : {1.0, 0.01, 30.0}) {
      OpenGlMatrix scaled = matrix;
      for (const int k : {0, 1, 2, 4, 5, 6, 8, 9, 10}) scaled[k] *= scale;
      const Pose back = pose_from_opengl(scaled);
      for (int k = 0; k < 9; ++k) EXPECT_NEAR(back.rotation[k], pose.rotation[k], 1e-13);
      for (int k = 0; k < 3; ++k) EXPECT_NEAR(back.translation[k], pose.translation[k], 1e-13);
    }
  }
}

TEST(OpenGlPose, RotationIsOrthonormalAlsoFromRoundedNumbers) {
  Pose pose;
  pose.rotation = rotation_from_quaternion({0.3, -0.5, 0.7, 0.2});
  OpenGlMatrix matrix = opengl_from_pose(pose);
  for (double& value : matrix) value = std::round(value * 1e4) / 1e4;
  const auto r = pose_from_opengl(matrix).rotation;
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      const double dot = r[3 * a] * r[3 * b] + r[3 * a + 1] * r[3 * b + 1] + r[3 * a + 2] * r[3 * b + 2];
      EXPECT_NEAR(dot, a == b ? 1 : 0, 1e-14);
    }
  }
  for (int k = 0; k < 9; ++k) EXPECT_NEAR(r[k], pose.rotation[k], 2e-4);
}

TEST(OpenGlPose, RefusesWhatIsNoPoseAndSaysWhere) {
  OpenGlMatrix mirrored = kIdentity;
  mirrored[0] = -1;
  EXPECT_NE(error_of(mirrored).find("transforms.json: frame 3: expected a rotation"), std::string::npos);
  EXPECT_NE(error_of(mirrored).find("mirrors"), std::string::npos) << error_of(mirrored);
  OpenGlMatrix stretched = kIdentity;
  stretched[5] = 2;
  EXPECT_NE(error_of(stretched).find("uniform scale"), std::string::npos) << error_of(stretched);
  OpenGlMatrix sheared = kIdentity;
  sheared[1] = 0.3;
  EXPECT_NE(error_of(sheared).find("not perpendicular"), std::string::npos) << error_of(sheared);
  OpenGlMatrix column_major = kIdentity;
  column_major[12] = 5;  // a translation in the last row
  EXPECT_NE(error_of(column_major).find("last row"), std::string::npos) << error_of(column_major);
  for (const double value : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e30}) {
    OpenGlMatrix broken = kIdentity;
    broken[3] = value;
    EXPECT_NE(error_of(broken).find("finite"), std::string::npos) << error_of(broken);
  }
  EXPECT_NE(error_of(OpenGlMatrix{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1}).find("determinant 0"),
            std::string::npos);
}

}  // namespace
}  // namespace b3dgs
