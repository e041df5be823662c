#include "support/raster/test_scenes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace b3dgs::test {
namespace {

constexpr double kShDegree0 = 0.28209479177387814;  // value of the constant spherical harmonic

/// Gives the same sequence with every standard library, unlike std::uniform_real_distribution.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
  }
  double log_uniform(double low, double high) { return std::exp(uniform(std::log(low), std::log(high))); }
  std::array<double, 3> uniform3(double low, double high) {
    const double a = uniform(low, high), b = uniform(low, high), c = uniform(low, high);
    return {a, b, c};
  }

 private:
  std::mt19937_64 engine_;
};

PinholeView make_view(int width, int height, double focal) {
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = view.fy = static_cast<float>(focal);
  view.cx = 0.5f * static_cast<float>(width);
  view.cy = 0.5f * static_cast<float>(height);
  view.width = width;
  view.height = height;
  return view;
}

using Quat = std::array<double, 4>;

std::array<double, 9> rotation_of(const Quat& q) {
  const auto [w, x, y, z] = q;
  return {w * w + x * x - y * y - z * z, 2 * (x * y - w * z),           2 * (x * z + w * y),
          2 * (x * y + w * z),           w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
          2 * (x * z - w * y),           2 * (y * z + w * x),           w * w - x * x - y * y + z * z};
}

/// Sets the camera's rotation, and moves its centre to `center`.
void set_pose(PinholeView& view, Quat q, std::array<double, 3> center) {
  const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (double& c : q) c /= length;
  const std::array<double, 9> r = rotation_of(q);
  for (int i = 0; i < 9; ++i) view.rotation.m[i] = static_cast<float>(r[i]);
  const auto translation = [&](int i) {
    return static_cast<float>(-(r[3 * i] * center[0] + r[3 * i + 1] * center[1] + r[3 * i + 2] * center[2]));
  };
  view.translation = {translation(0), translation(1), translation(2)};
  view.center = {static_cast<float>(center[0]), static_cast<float>(center[1]), static_cast<float>(center[2])};
}

/// A Gaussian described by its look in the image.
struct Splat2D {
  double x = 0, y = 0, depth = 1;       // px, px, world units
  std::array<double, 3> size{1, 1, 1};  // standard deviations, px at that depth
  Quat quat{1, 0, 0, 0};                // rotation in world space
  double opacity = 0.5;
  std::array<double, 3> color{0.5, 0.5, 0.5};  // degree 0
};

/// A Gaussian described in space.
struct SphereSplat {
  std::array<double, 3> camera{0, 0, 1};  // camera coordinates
  std::array<double, 3> size{1, 1, 1};    // standard deviations, world units
  Quat quat{1, 0, 0, 0};
  double opacity = 0.5;
  std::array<double, 3> color{0.5, 0.5, 0.5};
};

class SceneBuilder {
 public:
  SceneBuilder(const CameraView& view, int sh_degree_max) : sh_degree_max_(sh_degree_max) {
    scene_.view = view;
    scene_.sh_degree = sh_degree_max;
  }

  /// Adds a Gaussian. `sh_amplitude` bounds its coefficients above degree 0.
  void add(const Splat2D& splat, Random& random, double sh_amplitude = 0.0) {
    const PinholeView& view = scene_.view;
    SphereSplat sphere{
        {(splat.x - view.cx) * splat.depth / view.fx, (splat.y - view.cy) * splat.depth / view.fy, splat.depth},
        splat.size,
        splat.quat,
        splat.opacity,
        splat.color};
    for (double& size : sphere.size) size = size * std::abs(splat.depth) / view.fx;
    add_in_space(sphere, random, sh_amplitude);
  }

  void add_in_space(const SphereSplat& splat, Random& random, double sh_amplitude = 0.0) {
    const PinholeView& view = scene_.view;
    const std::array<double, 3> camera{splat.camera[0] - view.translation.x, splat.camera[1] - view.translation.y,
                                       splat.camera[2] - view.translation.z};
    const float* r = view.rotation.m;
    for (int i = 0; i < 3; ++i) {
      means_.push_back(static_cast<float>(r[i] * camera[0] + r[3 + i] * camera[1] + r[6 + i] * camera[2]));
    }
    for (double size : splat.size) log_scales_.push_back(static_cast<float>(std::log(size)));
    for (double c : splat.quat) quats_.push_back(static_cast<float>(c));
    logit_opacities_.push_back(static_cast<float>(std::log(splat.opacity / (1 - splat.opacity))));
    for (double c : splat.color) sh0_.push_back(static_cast<float>((c - 0.5) / kShDegree0));
    for (int i = 0; i < 3 * n_higher(); ++i) {
      shN_.push_back(static_cast<float>(random.uniform(-sh_amplitude, sh_amplitude)));
    }
  }

  TestScene build() const {
    TestScene scene = scene_;
    const std::int64_t n = static_cast<std::int64_t>(logit_opacities_.size());
    const auto tensor = [](const std::vector<float>& values, torch::IntArrayRef shape) {
      return torch::tensor(values, torch::kFloat32).view(shape);
    };
    scene.gaussians = {tensor(means_, {n, 3}),        tensor(log_scales_, {n, 3}), tensor(quats_, {n, 4}),
                       tensor(logit_opacities_, {n}), tensor(sh0_, {n, 1, 3}),     tensor(shN_, {n, n_higher(), 3})};
    return scene;
  }

 private:
  int n_higher() const { return (sh_degree_max_ + 1) * (sh_degree_max_ + 1) - 1; }

  TestScene scene_;
  int sh_degree_max_;
  std::vector<float> means_, log_scales_, quats_, logit_opacities_, sh0_, shN_;
};

struct Range {
  double min = 0, max = 0;
};

/// Ranges of add_cloud()'s uniform distributions. Sizes are uniform in the logarithm.
struct Cloud {
  int n = 0;
  Range x, y;  // px
  Range depth{2, 8};
  Range size{1, 3};  // px
  Range opacity{0.1, 0.8};
  Range color{0.1, 0.9};
  double sh_amplitude = 0.05;
};

/// Makes a cloud over the image and `margin` px around it.
Cloud cloud_over(const PinholeView& view, int n, double margin) {
  Cloud cloud;
  cloud.n = n;
  cloud.x = {-margin, view.width + margin};
  cloud.y = {-margin, view.height + margin};
  return cloud;
}

/// Gives each Gaussian a different depth. The order of depths is not that of the indices.
void add_cloud(SceneBuilder& builder, const Cloud& cloud, Random& random) {
  std::vector<int> depth_index(cloud.n);
  for (int i = 0; i < cloud.n; ++i) depth_index[i] = i;
  for (int i = cloud.n - 1; i > 0; --i)
    std::swap(depth_index[i], depth_index[static_cast<int>(random.uniform(0, i + 1))]);
  for (int i = 0; i < cloud.n; ++i) {
    Splat2D splat;
    splat.x = random.uniform(cloud.x.min, cloud.x.max);
    splat.y = random.uniform(cloud.y.min, cloud.y.max);
    const double place = (depth_index[i] + random.uniform(0.2, 0.8)) / cloud.n;
    splat.depth = cloud.depth.min + (cloud.depth.max - cloud.depth.min) * place;
    for (double& size : splat.size) size = random.log_uniform(cloud.size.min, cloud.size.max);
    for (double& c : splat.quat) c = random.uniform(-1, 1);
    splat.opacity = random.uniform(cloud.opacity.min, cloud.opacity.max);
    splat.color = random.uniform3(cloud.color.min, cloud.color.max);
    builder.add(splat, random, cloud.sh_amplitude);
  }
}

TestScene cloud_scene(const PinholeView& view, int sh_degree_max, const Cloud& cloud, std::uint64_t seed) {
  SceneBuilder builder(view, sh_degree_max);
  Random random(seed);
  add_cloud(builder, cloud, random);
  return builder.build();
}

}  // namespace

GaussianTensors make_spheres(const torch::Tensor& means, const torch::Tensor& scales, const torch::Tensor& opacities) {
  const std::int64_t n = means.size(0);
  return {means.to(torch::kFloat32).contiguous(),
          scales.log().to(torch::kFloat32).unsqueeze(1).repeat({1, 3}).contiguous(),
          torch::tensor({1.0f, 0.0f, 0.0f, 0.0f}).repeat({n, 1}).contiguous(),
          torch::logit(opacities).to(torch::kFloat32).contiguous(),
          torch::sin(0.37f * torch::arange(3 * n, torch::kFloat32)).view({n, 1, 3}).contiguous(),
          torch::zeros({n, 0, 3})};
}

TestScene empty_scene() {
  return SceneBuilder(make_view(20, 12, 20), 3).build();
}

TestScene one_splat() {
  SceneBuilder builder(make_view(32, 32, 30), 0);
  Random random(1);
  builder.add({8.5, 7.5, 2.0, {2, 2, 2}, {1, 0, 0, 0}, 0.7, {0.9, 0.5, 0.2}}, random);
  return builder.build();
}

TestScene splat_on_tile_corner() {
  SceneBuilder builder(make_view(32, 32, 32), 0);
  Random random(2);
  builder.add({16, 16, 2.0, {2.1, 2.1, 2.1}, {1, 0, 0, 0}, 0.8, {0.2, 0.6, 0.9}}, random);
  return builder.build();
}

TestScene behind_the_camera() {
  SceneBuilder builder(make_view(32, 16, 30), 1);
  Random random(3);
  for (double depth : {-5.0, -1.0, -0.21, -0.01, 0.01, 0.1, 0.19}) {
    Splat2D splat;
    splat.x = random.uniform(0, 32);
    splat.y = random.uniform(0, 16);
    splat.depth = depth;
    splat.size = {5, 5, 5};
    builder.add(splat, random, 0.1);
  }
  return builder.build();
}

TestScene around_the_near_plane() {
  const PinholeView view = make_view(40, 24, 36);
  SceneBuilder builder(view, 1);
  Random random(4);
  Cloud cloud = cloud_over(view, 40, 4);
  cloud.depth = {0.02, 0.6};
  add_cloud(builder, cloud, random);
  cloud.n = 10;
  cloud.depth = {-4, -0.05};
  add_cloud(builder, cloud, random);
  return builder.build();
}

TestScene thirty_three_in_one_tile() {
  Cloud cloud;
  cloud.n = 33;
  cloud.x = {21.5, 26.5};  // the third tile of 8 rows in the second column
  cloud.y = {19.5, 20.5};
  cloud.size = {0.3, 0.8};
  cloud.opacity = {0.05, 0.3};
  return cloud_scene(make_view(48, 32, 40), 1, cloud, 5);
}

TestScene ten_thousand_in_one_tile() {
  Cloud cloud;
  cloud.n = 10000;
  cloud.x = cloud.y = {4, 12};
  cloud.depth.max = 6;
  cloud.size = {0.3, 1.0};
  cloud.opacity = {0.01, 0.04};
  return cloud_scene(make_view(20, 16, 30), 0, cloud, 202);
}

TestScene ends_along_a_long_list() {
  const PinholeView view = make_view(16, 12, 24);
  SceneBuilder builder(view, 0);
  Random random(203);
  Cloud faint = cloud_over(view, 6000, -1);
  faint.depth = {1, 6};
  faint.size = {0.4, 0.8};
  faint.opacity = {0.01, 0.02};
  add_cloud(builder, faint, random);
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 3; ++row) {
      for (int layer = 0; layer < 5; ++layer) {
        Splat2D splat;
        splat.x = 2.4 + 4 * column;
        splat.y = 2.3 + 4 * row;
        splat.depth = 1.3 + 1.2 * column + 0.07 * layer;
        splat.size = {1.3, 1.3, 1.3};
        splat.opacity = 0.9;
        splat.color = random.uniform3(0.1, 0.9);
        builder.add(splat, random);
      }
    }
  }
  return builder.build();
}

TestScene opaque_front_layer() {
  const PinholeView view = make_view(40, 24, 40);
  SceneBuilder builder(view, 1);
  Random random(7);
  for (int layer = 0; layer < 5; ++layer) {
    Splat2D splat;
    splat.x = 20.3 + layer;
    splat.y = 12.2 - layer;
    splat.depth = 1 + 0.1 * layer;
    splat.size = {100, 100, 100};
    splat.opacity = 0.96 - 0.01 * layer;
    splat.color = random.uniform3(0.1, 0.9);
    builder.add(splat, random, 0.05);
  }
  add_cloud(builder, cloud_over(view, 60, 4), random);
  return builder.build();
}

TestScene saturated_pixels() {
  const PinholeView view = make_view(48, 40, 44);
  Cloud cloud = cloud_over(view, 180, 6);
  cloud.size = {2, 6};
  cloud.opacity = {0.4, 0.98};
  return cloud_scene(view, 1, cloud, 8);
}

TestScene odd_image_size() {
  const PinholeView view = make_view(37, 29, 33);
  return cloud_scene(view, 2, cloud_over(view, 70, 5), 9);
}

TestScene one_pixel_image() {
  const PinholeView view = make_view(1, 1, 1.2);
  return cloud_scene(view, 1, cloud_over(view, 6, 1), 10);
}

TestScene anisotropic_cloud() {
  PinholeView view = make_view(64, 48, 55);
  set_pose(view, {0.9, 0.2, -0.3, 0.1}, {0.7, -1.1, 0.4});
  Cloud cloud = cloud_over(view, 300, 8);
  cloud.size = {0.4, 6};
  cloud.opacity = {0.02, 0.95};
  cloud.sh_amplitude = 0.15;
  return cloud_scene(view, 3, cloud, 11);
}

TestScene off_centre_principal_point() {
  PinholeView view = make_view(48, 40, 42);
  view.fy = 37.5f;
  view.cx = 9.3f;
  view.cy = 33.1f;
  set_pose(view, {0.8, -0.3, 0.2, 0.4}, {-2.0, 0.5, 1.5});
  Cloud cloud = cloud_over(view, 90, 20);
  cloud.size.max = 8;
  return cloud_scene(view, 3, cloud, 12);
}

TestScene far_outside_the_field_of_view() {
  PinholeView view = make_view(48, 32, 40);
  view.cx = 20.0f;
  set_pose(view, {0.95, 0.1, 0.2, -0.1}, {0.2, 0.3, -0.4});
  SceneBuilder builder(view, 1);
  Random random(13);
  for (double x : {-90.0, -40.0, 20.0, 75.0, 110.0}) {
    for (double y : {-70.0, -25.0, 15.0, 60.0, 95.0}) {
      Splat2D splat;
      splat.x = x + random.uniform(-3, 3);
      splat.y = y + random.uniform(-3, 3);
      splat.depth = random.uniform(0.5, 4);
      splat.size = random.uniform3(15, 45);
      for (double& c : splat.quat) c = random.uniform(-1, 1);
      splat.opacity = random.uniform(0.1, 0.5);
      splat.color = random.uniform3(0.1, 0.9);
      builder.add(splat, random, 0.05);
    }
  }
  return builder.build();
}

TestScene needles() {
  const PinholeView view = make_view(48, 48, 45);
  SceneBuilder builder(view, 1);
  Random random(14);
  for (int i = 0; i < 60; ++i) {
    Splat2D splat;
    splat.x = random.uniform(0, 48);
    splat.y = random.uniform(0, 48);
    splat.depth = 2 + 0.07 * i;
    splat.size = {random.uniform(6, 15), random.uniform(0.01, 0.1), random.uniform(0.01, 0.1)};
    for (double& c : splat.quat) c = random.uniform(-1, 1);
    splat.opacity = random.uniform(0.2, 0.9);
    splat.color = random.uniform3(0.1, 0.9);
    builder.add(splat, random, 0.05);
  }
  return builder.build();
}

TestScene tiny_splats() {
  const PinholeView view = make_view(33, 17, 30);
  Cloud cloud = cloud_over(view, 150, 1);
  cloud.size = {1e-4, 0.2};
  return cloud_scene(view, 1, cloud, 15);
}

TestScene negative_colors() {
  const PinholeView view = make_view(32, 24, 30);
  Cloud cloud = cloud_over(view, 50, 2);
  cloud.color = {-0.6, 0.8};
  cloud.sh_amplitude = 0.2;
  return cloud_scene(view, 2, cloud, 16);
}

TestScene unnormalised_quaternions() {
  const PinholeView view = make_view(32, 24, 30);
  Cloud cloud = cloud_over(view, 50, 2);
  cloud.size.max = 6;
  TestScene scene = cloud_scene(view, 0, cloud, 17);
  scene.gaussians.quats *= torch::logspace(-3, 3, 50, 10.0, torch::kFloat32).unsqueeze(1);
  return scene;
}

TestScene equal_depths() {
  const PinholeView view = make_view(32, 24, 30);
  Cloud cloud = cloud_over(view, 60, 2);
  cloud.size = {3, 6};
  cloud.opacity.min = 0.5;
  TestScene scene = cloud_scene(view, 1, cloud, 18);
  const torch::Tensor depth = scene.gaussians.means.select(1, 2);
  depth.copy_(torch::remainder(torch::arange(60, torch::kFloat32), 3) + 2);  // 2, 3, 4, 2, 3, ...
  return scene;
}

TestScene at_the_cap() {
  const PinholeView view = make_view(40, 40, 38);
  Cloud cloud = cloud_over(view, 25, 0);
  cloud.size = {4, 10};
  cloud.opacity = {0.992, 0.9999};
  return cloud_scene(view, 1, cloud, 19);
}

TestScene near_the_cutoff() {
  const PinholeView view = make_view(40, 24, 38);
  Cloud cloud = cloud_over(view, 120, 0);
  cloud.size = {1, 5};
  cloud.opacity = {0.0035, 0.005};
  return cloud_scene(view, 1, cloud, 20);
}

TestScene degree_below_maximum() {
  const PinholeView view = make_view(32, 24, 30);
  TestScene scene = cloud_scene(view, 3, cloud_over(view, 40, 2), 21);
  scene.sh_degree = 1;
  return scene;
}

TestScene no_higher_degrees() {
  const PinholeView view = make_view(32, 24, 30);
  return cloud_scene(view, 0, cloud_over(view, 40, 2), 22);
}

TestScene smooth_scene() {
  PinholeView view = make_view(9, 7, 12);
  view.cx = 4.125f;
  set_pose(view, {0.9, 0.1, -0.2, 0.15}, {0.4, -0.3, 0.2});
  Cloud cloud = cloud_over(view, 7, -2);
  cloud.size = {3.5, 9};
  cloud.opacity = {0.3, 0.7};
  cloud.color.min = 0.4;
  return cloud_scene(view, 3, cloud, 23);
}

namespace {

/// Makes Gaussians in all directions of the camera up to `max_angle` (degrees).
TestScene lens_scene(const CameraView& view, double max_angle, std::uint64_t seed) {
  constexpr int kCount = 260;
  SceneBuilder builder(view, 2);
  Random random(seed);
  std::vector<int> order(kCount);
  for (int i = 0; i < kCount; ++i) order[i] = i;
  for (int i = kCount - 1; i > 0; --i) std::swap(order[i], order[static_cast<int>(random.uniform(0, i + 1))]);
  for (int i = 0; i < kCount; ++i) {
    const double angle = max_angle * M_PI / 180 * std::sqrt(random.uniform(0.001, 1));
    const double azimuth = random.uniform(0, 2 * M_PI);
    const double distance = 1 + 6 * (order[i] + random.uniform(0.2, 0.8)) / kCount;
    SphereSplat splat;
    splat.camera = {distance * std::sin(angle) * std::cos(azimuth), distance * std::sin(angle) * std::sin(azimuth),
                    distance * std::cos(angle)};
    if (!has_radial_depth(view.lens)) {
      for (double& value : splat.camera) value /= std::cos(angle);
    }
    for (double& size : splat.size) size = distance * random.log_uniform(0.01, i % 20 == 0 ? 0.9 : 0.1);
    for (double& c : splat.quat) c = random.uniform(-1, 1);
    splat.opacity = random.uniform(0.1, 0.8);
    splat.color = random.uniform3(0.2, 0.9);
    builder.add_in_space(splat, random, 0.05);
  }
  return builder.build();
}

CameraView lens_view(LensKind kind, double focal, double max_angle, std::initializer_list<float> coefficients) {
  CameraView view = make_view(56, 48, focal);
  view.fy *= 1.06f;
  view.cx += 1.3f;
  view.lens.kind = kind;
  view.lens.max_angle = static_cast<float>(max_angle * M_PI / 180);
  std::copy(coefficients.begin(), coefficients.end(), view.lens.k);
  set_pose(view, {0.7, -0.4, 0.2, 0.5}, {0.2, -0.3, 0.4});
  return view;
}

}  // namespace

TestScene distorted_lens() {
  return lens_scene(lens_view(LensKind::kDistorted, 30, 48,
                              {-0.12f, 0.04f, -0.005f, 0, 0.02f, 0.01f, 0.002f, 0.01f, -0.015f, 0.006f, -0.004f}),
                    65, 31);
}

TestScene fov_lens() {
  return lens_scene(lens_view(LensKind::kFov, 25, 60, {1.1f}), 70, 32);
}

TestScene division_lens() {
  return lens_scene(lens_view(LensKind::kDivision, 25, 50, {-0.25f}), 65, 33);
}

TestScene eucm_lens() {
  return lens_scene(lens_view(LensKind::kEucm, 25, 62, {0.6f, 1.1f}), 72, 34);
}

TestScene fisheye_lens() {
  return lens_scene(lens_view(LensKind::kFisheye, 15, 110, {0.03f, -0.012f, 0.002f, -0.0002f}), 175, 35);
}

TestScene prism_fisheye_lens() {
  return lens_scene(lens_view(LensKind::kFisheye, 25, 66,
                              {-0.04f, 0.01f, 0.003f, -0.001f, 0, 0, 0, 0.006f, -0.008f, 0.003f, -0.002f}),
                    75, 36);
}

TestScene panorama() {
  CameraView view = make_view(96, 48, 1);
  view.fx = static_cast<float>(96 / (2 * M_PI));
  view.fy = static_cast<float>(48 / M_PI);
  view.lens.kind = LensKind::kEquirectangular;
  set_pose(view, {0.7, -0.4, 0.2, 0.5}, {0.2, -0.3, 0.4});
  constexpr int kCount = 220;
  SceneBuilder builder(view, 1);
  Random random(37);
  for (int i = 0; i < kCount; ++i) {
    const double longitude = (i % 4 == 0 ? M_PI + random.uniform(-0.2, 0.2) : random.uniform(-M_PI, M_PI));
    const double latitude = i < 4 ? (i % 2 == 0 ? 1.52 : -1.52) : random.uniform(-1.2, 1.2);
    const double distance = 1 + 5 * (i * 37 % kCount + random.uniform(0.2, 0.8)) / kCount;
    SphereSplat splat;
    splat.camera = {distance * std::cos(latitude) * std::sin(longitude), distance * std::sin(latitude),
                    distance * std::cos(latitude) * std::cos(longitude)};
    for (double& size : splat.size) size = distance * std::cos(latitude) * random.log_uniform(0.02, 0.2);
    for (double& c : splat.quat) c = random.uniform(-1, 1);
    splat.opacity = random.uniform(0.1, 0.8);
    splat.color = random.uniform3(0.2, 0.9);
    builder.add_in_space(splat, random, 0.05);
  }
  return builder.build();
}

TestScene large_cloud() {
  PinholeView view = make_view(80, 72, 70);
  set_pose(view, {0.9, -0.2, 0.1, 0.3}, {0.3, 1.1, -0.6});
  SceneBuilder builder(view, 1);
  Random random(24);
  Cloud cloud = cloud_over(view, 10000, 10);
  cloud.size.min = 0.2;
  cloud.opacity.max = 0.4;
  for (const auto& [depth_min, depth_max] : {std::pair(1.0, 6.0), std::pair(-5.0, 0.1), std::pair(2.0, 9.0)}) {
    cloud.depth = {depth_min, depth_max};
    add_cloud(builder, cloud, random);
  }
  return builder.build();
}

const std::vector<TestSceneRow>& test_scenes() {
  static const std::vector<TestSceneRow> rows{
      {"empty", empty_scene},
      {"one_splat", one_splat},
      {"splat_on_tile_corner", splat_on_tile_corner},
      {"behind_the_camera", behind_the_camera},
      {"around_the_near_plane", around_the_near_plane},
      {"thirty_three_in_one_tile", thirty_three_in_one_tile},
      {"ten_thousand_in_one_tile", ten_thousand_in_one_tile},
      {"ends_along_a_long_list", ends_along_a_long_list},
      {"opaque_front_layer", opaque_front_layer},
      {"saturated_pixels", saturated_pixels},
      {"odd_image_size", odd_image_size},
      {"one_pixel_image", one_pixel_image},
      {"anisotropic_cloud", anisotropic_cloud},
      {"off_centre_principal_point", off_centre_principal_point},
      {"far_outside_the_field_of_view", far_outside_the_field_of_view},
      {"needles", needles},
      {"tiny_splats", tiny_splats},
      {"negative_colors", negative_colors},
      {"unnormalised_quaternions", unnormalised_quaternions},
      {"equal_depths", equal_depths},
      {"at_the_cap", at_the_cap},
      {"near_the_cutoff", near_the_cutoff},
      {"degree_below_maximum", degree_below_maximum},
      {"no_higher_degrees", no_higher_degrees},
      {"distorted_lens", distorted_lens},
      {"fov_lens", fov_lens},
      {"division_lens", division_lens},
      {"eucm_lens", eucm_lens},
      {"fisheye_lens", fisheye_lens},
      {"prism_fisheye_lens", prism_fisheye_lens},
      {"panorama", panorama},
      {"smooth", smooth_scene},
  };
  return rows;
}

}  // namespace b3dgs::test
