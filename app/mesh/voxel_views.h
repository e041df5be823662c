// Depth images as the voxels of a grid see them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "app/mesh/depth_views.h"

namespace b3dgs {

/// A view whose depths are looked up at voxels. `origin` is the voxel that has the coordinates 0.
class VoxelView {
 public:
  VoxelView(const DepthView& view, double voxel, const Vec3<double>& origin)
      : view_(view), camera_(view.camera), is_pinhole_(view.camera.is_pinhole()), voxel_(voxel) {
    const std::array<double, 9>& r = camera_.cam_from_world.rotation;
    const std::array<double, 3>& t = camera_.cam_from_world.translation;
    for (std::size_t i = 0; i < 9; ++i) axes_.m[i] = voxel * r[i];
    zero_ = axes_ * origin + Vec3<double>{t[0], t[1], t[2]};
  }

  /// Returns the camera coordinates of a point of the grid.
  Vec3<double> in_camera(const Vec3<double>& at) const { return axes_ * at + zero_; }

  /// Returns false if no voxel within `radius` voxels of a point can be in the image.
  bool may_see(const Vec3<double>& at, double radius) const {
    if (!is_pinhole_) return true;
    const Vec3<double> q = in_camera(at);
    const double r = radius * voxel_;
    // Signed distances from the four planes through the camera centre and the sides of the image, up to their normals.
    const auto is_inside = [&](double focal, double toward, double side) {
      return focal * toward + side * q.z >= -r * std::sqrt(focal * focal + side * side);
    };
    return q.z > -r && is_inside(camera_.fx, q.x, camera_.cx) && is_inside(camera_.fy, q.y, camera_.cy) &&
           is_inside(camera_.fx, -q.x, camera_.width - camera_.cx) &&
           is_inside(camera_.fy, -q.y, camera_.height - camera_.cy);
  }

  /// Adds the distance of a voxel from the surface and the weight of the view, unless the view does not see the voxel.
  void add(const Vec3<double>& at, double truncation, double& sum, double& weight) const {
    const Vec3<double> q = in_camera(at);
    double u = 0, v = 0, z = q.z;
    if (is_pinhole_) {
      if (!(z > 0)) return;
      u = camera_.fx * q.x / z + camera_.cx - 0.5;
      v = camera_.fy * q.y / z + camera_.cy - 0.5;
    } else {
      const auto seen = camera_.image_of({q.x, q.y, q.z});
      if (!seen) return;
      u = seen->x - 0.5;
      v = seen->y - 0.5;
      z = seen->depth;
    }
    if (!(u >= 0 && v >= 0 && u <= camera_.width - 1 && v <= camera_.height - 1)) return;
    const std::size_t nearest = view_.index(static_cast<int>(u + 0.5), static_cast<int>(v + 0.5));
    if (!(view_.depth[nearest] > 0)) return;
    const double depth = depth_at(u, v, truncation, view_.depth[nearest]);
    if (depth - z < -truncation) return;
    const double cosine = view_.cosine[nearest] * (1.0 / kCosineLevels);
    const double w = cosine * cosine / (depth * depth);
    sum += w * std::min(depth - z, truncation);
    weight += w;
  }

 private:
  /// Interpolates where four pixels are on one surface, in inverse depth, which is affine on planes.
  double depth_at(double u, double v, double truncation, double nearest) const {
    if (camera_.width < 2 || camera_.height < 2) return nearest;
    const int x = std::min(static_cast<int>(u), camera_.width - 2),
              y = std::min(static_cast<int>(v), camera_.height - 2);
    const float* const upper = &view_.depth[view_.index(x, y)];
    const float* const lower = upper + camera_.width;
    const auto [low, high] = std::minmax({upper[0], upper[1], lower[0], lower[1]});
    if (!(low > 0 && high - low < truncation)) return nearest;
    const double s = u - x, t = v - y;
    return 1 / ((1 - t) * ((1 - s) / upper[0] + s / upper[1]) + t * ((1 - s) / lower[0] + s / lower[1]));
  }

  const DepthView& view_;
  const Camera& camera_;
  bool is_pinhole_;
  double voxel_;
  Mat3<double> axes_{};  // camera coordinates of the steps along the grid's axes
  Vec3<double> zero_{};  // and of its voxel 0
};

}  // namespace b3dgs
