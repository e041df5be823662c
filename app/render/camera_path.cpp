#include "app/render/camera_path.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace b3dgs {
namespace {

using Quat = std::array<double, 4>;
using Vec = std::array<double, 3>;

Quat slerp(const Quat& a, Quat b, double share) {
  double cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  if (cosine < 0) {  // b and -b are the same rotation: take the shorter path
    cosine = -cosine;
    for (double& value : b) value = -value;
  }
  const double angle = std::acos(std::min(cosine, 1.0));
  const bool is_tiny = angle < 1e-6;  // sin(angle) would vanish; linear interpolation is accurate enough
  const double weight_a = is_tiny ? 1 - share : std::sin((1 - share) * angle) / std::sin(angle);
  const double weight_b = is_tiny ? share : std::sin(share * angle) / std::sin(angle);
  Quat result{};
  for (int i = 0; i < 4; ++i) result[i] = weight_a * a[i] + weight_b * b[i];
  return result;
}

/// Catmull-Rom segment from p1 to p2, t in [0, 1].
Vec catmull_rom(const Vec& p0, const Vec& p1, const Vec& p2, const Vec& p3, double t) {
  Vec result{};
  for (int i = 0; i < 3; ++i) {
    result[i] =
        p1[i] + 0.5 * t *
                    (p2[i] - p0[i] +
                     t * (2 * p0[i] - 5 * p1[i] + 4 * p2[i] - p3[i] + t * (3 * (p1[i] - p2[i]) + p3[i] - p0[i])));
  }
  return result;
}

}  // namespace

std::vector<Camera> interpolate_cameras(const std::vector<Camera>& keys, int frames) {
  B3DGS_CHECK(!keys.empty() && frames > 0, "keys: ", keys.size(), ", frames: ", frames);
  const int last = static_cast<int>(keys.size()) - 1;
  std::vector<Camera> path;
  for (int frame = 0; frame < frames; ++frame) {
    const double place = frames > 1 ? static_cast<double>(last) * frame / (frames - 1) : 0;
    const int key = std::clamp(static_cast<int>(place), 0, std::max(0, last - 1));
    const double share = place - key;
    const auto at = [&](int index) -> const Camera& {
      return keys[static_cast<std::size_t>(std::clamp(index, 0, last))];
    };

    Camera camera = at(key).scaled_to(keys[0].width, keys[0].height);
    const Camera next = at(key + 1).scaled_to(keys[0].width, keys[0].height);
    camera.fx += share * (next.fx - camera.fx);
    camera.fy += share * (next.fy - camera.fy);
    camera.cx += share * (next.cx - camera.cx);
    camera.cy += share * (next.cy - camera.cy);

    Pose& pose = camera.cam_from_world;
    pose.rotation = rotation_from_quaternion(
        slerp(quaternion_from_rotation(pose.rotation), quaternion_from_rotation(next.cam_from_world.rotation), share));
    const Vec center =
        catmull_rom(at(key - 1).center(), at(key).center(), at(key + 1).center(), at(key + 2).center(), share);
    for (int i = 0; i < 3; ++i) {
      const double* row = &pose.rotation[static_cast<std::size_t>(3 * i)];
      pose.translation[static_cast<std::size_t>(i)] = -(row[0] * center[0] + row[1] * center[1] + row[2] * center[2]);
    }
    path.push_back(camera);
  }
  return path;
}

}  // namespace b3dgs
