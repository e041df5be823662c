#include "app/mesh/ray_cast_views.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "app/mesh/triangle_scene.h"
#include "core/parallel.h"
#include "data_synth/random.h"
#include "data_synth/truth_mesh.h"

namespace b3dgs::test {
namespace {

using Vec = Vec3<double>;

constexpr int kViews = 40;
constexpr double kDistance = 3.6;
constexpr Vec kTarget{0, 0, 0.7};

Vec unit(const Vec& v) {
  return (1 / std::sqrt(dot(v, v))) * v;
}

Camera look_at_target(const Vec& eye, int width) {
  const Vec forward = unit(kTarget - eye), right = unit(cross(forward, {0, 0, 1})), down = cross(forward, right);
  Camera camera;
  camera.width = width;
  camera.height = width * 3 / 4;
  camera.fx = camera.fy = 0.5 * width / std::tan(25 * kDegree);
  camera.cx = 0.5 * camera.width;
  camera.cy = 0.5 * camera.height;
  camera.cam_from_world.rotation = {right.x, right.y, right.z, down.x, down.y, down.z, forward.x, forward.y, forward.z};
  camera.cam_from_world.translation = {-dot(right, eye), -dot(down, eye), -dot(forward, eye)};
  return camera;
}

/// Makes cameras on a spiral. elevation(share) is in radians.
template <class Elevation>
std::vector<Camera> spiral(int width, const Elevation& elevation) {
  Random random(1);
  std::vector<Camera> cameras;
  for (int i = 0; i < kViews; ++i) {
    const double up = elevation((i + 0.5) / kViews), turn = 2 * kPi * 0.618034 * i;
    const double distance = kDistance * random.uniform(0.9, 1.1);
    const Vec toward{std::cos(up) * std::cos(turn), std::cos(up) * std::sin(turn), std::sin(up)};
    cameras.push_back(look_at_target(kTarget + distance * toward, width));
  }
  return cameras;
}

/// Returns noise with standard deviation 0.7, smooth over 8 px.
std::vector<double> smooth_noise(int width, int height, Random& random) {
  const int columns = width / 8 + 2, rows = height / 8 + 2;
  std::vector<double> knots(static_cast<std::size_t>(columns) * rows), noise;
  for (double& knot : knots) knot = random.normal();
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double* const upper = &knots[static_cast<std::size_t>(y / 8) * columns + x / 8];
      const double* const lower = upper + columns;
      const double s = x % 8 / 8.0, t = y % 8 / 8.0;
      noise.push_back(0.7 * ((1 - t) * ((1 - s) * upper[0] + s * upper[1]) + t * ((1 - s) * lower[0] + s * lower[1])));
    }
  }
  return noise;
}

/// A depth image and its normals in camera coordinates.
struct Cast {
  std::vector<float> depth, normals;  // [height, width], [height, width, 3]

  void set_normal(std::size_t pixel, const Vec& normal) {
    normals[3 * pixel] = static_cast<float>(normal.x);
    normals[3 * pixel + 1] = static_cast<float>(normal.y);
    normals[3 * pixel + 2] = static_cast<float>(normal.z);
  }
};

Cast cast_rays(const SolidScene& scene, const TriangleScene& surface, const Camera& camera) {
  const std::vector<Vec3f> rays = pixel_rays(camera);
  const std::array<double, 9>& rotation = camera.cam_from_world.rotation;
  const auto in_floats = [](const std::array<double, 3>& v) {
    return Vec3f{static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
  };
  Cast cast{std::vector<float>(rays.size()), std::vector<float>(3 * rays.size())};
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Vec3f direction = in_floats(rotated_back(rotation, {rays[i].x, rays[i].y, rays[i].z}));
    const auto hit = surface.first_hit(in_floats(camera.center()), direction, std::numeric_limits<float>::infinity());
    if (!hit) continue;
    cast.depth[i] = hit->t;
    const Vec normal = unit(scene.surface.area_normal(scene.surface.triangles[hit->triangle]));
    const std::array<double, 3> turned = rotated(rotation, {normal.x, normal.y, normal.z});
    cast.set_normal(i, {turned[0], turned[1], turned[2]});
  }
  return cast;
}

void add_errors(const DepthErrors& errors, const Camera& camera, Random& random, Cast& cast) {
  const std::vector<double> smooth = smooth_noise(camera.width, camera.height, random);
  for (std::size_t i = 0; i < cast.depth.size(); ++i) {
    if (cast.depth[i] == 0) continue;
    cast.depth[i] *= static_cast<float>(1 + errors.noise * (0.7 * random.normal() + smooth[i]));
    const Vec tilt{random.normal(), random.normal(), random.normal()};
    cast.set_normal(
        i, unit(Vec{cast.normals[3 * i], cast.normals[3 * i + 1], cast.normals[3 * i + 2]} + errors.tilt * tilt));
  }
  for (int k = 0; k < errors.floaters; ++k) {
    const double x = random.uniform(0, camera.width), y = random.uniform(0, camera.height);
    const double radius = random.uniform(3, 9) * camera.width / 320, depth = kDistance * random.uniform(0.3, 0.9);
    for (std::size_t i = 0; i < cast.depth.size(); ++i) {
      const auto column = static_cast<double>(i % camera.width), row = static_cast<double>(i / camera.width);
      if (std::hypot(column - x, row - y) >= radius) continue;
      cast.depth[i] = static_cast<float>(depth * (1 + 0.01 * random.normal()));
      cast.set_normal(i, {0, 0, -1});
    }
  }
}

void append_floating_solids(TriangleMesh& mesh) {
  append_ball({-0.9, -0.3, 0.85}, 0.6, mesh);
  append_box({0.75, 0.35, 0.75}, {0.5, 0.42, 0.42}, true, mesh);
}

}  // namespace

SolidScene closed_scene(int width) {
  SolidScene scene{{}, spiral(width, [](double share) { return std::asin(-0.95 + 1.9 * share); })};
  append_floating_solids(scene.surface);
  return scene;
}

SolidScene open_scene(int width) {
  SolidScene scene{{}, spiral(width, [](double share) { return (12 + 58 * share) * kDegree; })};
  append_floating_solids(scene.surface);
  append_disc({0, 0, 0}, 2.2, scene.surface);
  return scene;
}

std::vector<DepthView> ray_cast_views(const SolidScene& scene, const DepthErrors& errors) {
  const TriangleScene surface(scene.surface);
  std::vector<DepthView> views(scene.cameras.size());
  parallel_pool(static_cast<std::int64_t>(views.size()), [&](std::int64_t i, int) {
    const Camera& camera = scene.cameras[static_cast<std::size_t>(i)];
    Cast cast = cast_rays(scene, surface, camera);
    Random random(100 + i);
    if (errors.noise > 0) add_errors(errors, camera, random, cast);
    views[static_cast<std::size_t>(i)] = make_depth_view(camera, std::move(cast.depth), cast.normals.data(), 100);
  });
  return views;
}

}  // namespace b3dgs::test
