// Refines the poses of training cameras (--pose_opt). Each view has a correction, which takes a step of Adam after each
// iteration that used the view. The first and the last view by name stay fixed, because nothing else would keep the
// scene in its place.
//
// Steps are taken on the host, in double. With a GPU, this happens while the next iteration is running, or earlier if
// that iteration uses the same view, a checkpoint is written or the cameras are saved. Results do not depend on when it
// happens.
#pragma once

#include <torch/types.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "config/train_config.h"
#include "core/vec.h"
#include "raster/args.h"
#include "raster/torch/torch_cuda.h"
#include "scene/cameras/camera.h"
#include "scene/scene.h"

namespace b3dgs {

using Vec3d = Vec3<double>;
using Mat3d = Mat3<double>;

/// Moves a camera in its own frame: x_camera = exp(rotation) (R x_world + t) + translation. The camera turns about its
/// centre by |rotation|, and its centre moves by |translation|.
struct CameraCorrection {
  Vec3d rotation{0, 0, 0};     // rotation vector: axis times angle, rad
  Vec3d translation{0, 0, 0};  // world units
};

namespace detail {

/// Functions of an angle a in Rodrigues' formulas: sin(a) / a, (1 - cos(a)) / a^2 and (a - sin(a)) / a^3.
struct AngleRatios {
  double sine, cosine, rest;
};

inline AngleRatios angle_ratios(double square) {
  if (square < 1e-6) {  // Taylor series, whose next terms are below 1e-15
    return {1 - square / 6 + square * square / 120, 0.5 - square / 24 + square * square / 720,
            1.0 / 6 - square / 120 + square * square / 5040};
  }
  const double angle = std::sqrt(square);
  return {std::sin(angle) / angle, (1 - std::cos(angle)) / square, (angle - std::sin(angle)) / (angle * square)};
}

inline Vec3d at_most(Vec3d v, double limit) {
  const double length = std::sqrt(dot(v, v));
  return length > limit ? (limit / length) * v : v;
}

}  // namespace detail

/// Returns exp(rotation) v.
inline Vec3d rotate(Vec3d rotation, Vec3d v) {
  const detail::AngleRatios ratios = detail::angle_ratios(dot(rotation, rotation));
  const Vec3d turned = cross(rotation, v);
  return v + ratios.sine * turned + ratios.cosine * cross(rotation, turned);
}

/// Returns the pose with the correction applied.
inline Pose corrected(const Pose& pose, const CameraCorrection& correction) {
  Pose result;
  for (std::size_t column = 0; column < 3; ++column) {
    const Vec3d turned =
        rotate(correction.rotation, {pose.rotation[column], pose.rotation[3 + column], pose.rotation[6 + column]});
    result.rotation[column] = turned.x;
    result.rotation[3 + column] = turned.y;
    result.rotation[6 + column] = turned.z;
  }
  const std::array<double, 3>& t = pose.translation;
  const Vec3d moved = rotate(correction.rotation, {t[0], t[1], t[2]}) + correction.translation;
  result.translation = {moved.x, moved.y, moved.z};
  return result;
}

/// Returns the gradient with respect to the correction. `motion` is the gradient with respect to a small motion of the
/// corrected camera, x_camera -> x_camera + w x x_camera + v (raster/math/gaussian_grad.h), with w and v as its two
/// members.
///
/// A change of the rotation by dr gives w = J dr, where J is the left Jacobian of SO(3). It does not move the
/// translation u, to which the rotation is not applied, so v = u x w. The gradient is J^T (dL/dw + dL/dv x u).
inline CameraCorrection correction_grad(const CameraCorrection& at, const CameraCorrection& motion) {
  const detail::AngleRatios ratios = detail::angle_ratios(dot(at.rotation, at.rotation));
  const Vec3d turn = motion.rotation + cross(motion.translation, at.translation);
  const Vec3d crossed = cross(at.rotation, turn);
  return {turn - ratios.cosine * crossed + ratios.rest * cross(at.rotation, crossed), motion.translation};
}

/// Limits the correction to an angle in rad and a distance in world units.
inline CameraCorrection limited(const CameraCorrection& correction, double most_angle, double most_distance) {
  return {detail::at_most(correction.rotation, most_angle), detail::at_most(correction.translation, most_distance)};
}

// The state of pose refinement, which is part of the training state. Tensors are in host memory.

/// Corrections of V training views, with a row each. Tensors are undefined if no pose has been refined.
struct PoseState {
  torch::Tensor corrections;     // [V, 6] float: rotation vector (rad), translation (world units)
  torch::Tensor adam_m, adam_v;  // [V, 6] float
  torch::Tensor steps;           // [V] int32, number of steps of each view

  bool is_defined() const { return corrections.defined(); }
  /// Returns the initial state, with corrections of 0.
  static PoseState make(std::int64_t n_views);
  CameraCorrection correction(std::size_t view) const;
};

/// Returns `views`. Those that are training views, by name, get their corrected poses.
std::vector<View> with_refined_poses(std::vector<View> views, const std::vector<View>& train, const PoseState& state);

/// Refines the poses. A correction is limited to 3 degrees and 3 % of the scene extent.
class PoseRefiner {
 public:
  /// All arguments must outlive this object.
  PoseRefiner(const TrainConfig& config, const Scene& scene, PoseState& state)
      : config_(config), scene_(scene), state_(state) {}

  /// Returns whether the iteration refines the pose of the view, for which it needs the camera's gradient.
  bool refines(std::int32_t view, int iteration) const;

  /// Returns the camera with its corrected pose, for an iteration. Waits for the GPU if a step of this view has been
  /// queued but not taken. Allocates the memory for the step of this iteration.
  CameraView camera(std::int32_t view, int iteration);

  /// Adds the gradient of an iteration (ViewStatistics::camera_grad). A step may have one or several. Those of the
  /// previous step must have been taken. Asynchronous on a GPU.
  void add_gradient(std::int32_t view, int iteration, const torch::Tensor& camera_grad);

  /// Queues the gradients added since the last call for take_queued_steps(). Until then, drop_gradients() can discard
  /// them.
  void queue_step();
  void drop_gradients() { added_.clear(); }

  /// Waits for the gradients of the last queue_step(), and takes the steps along them in their order, unless this has
  /// been done. Ignores gradients that are not finite.
  void take_queued_steps();

 private:
  struct Unfinished {
    std::int32_t view = 0;
    int iteration = 0;
  };
  using CameraGrad = std::array<double, kCameraGradients>;
  void make_room();
  void take_step(std::int32_t view, int iteration, const CameraGrad& grad);

  const TrainConfig& config_;
  const Scene& scene_;
  PoseState& state_;
  std::vector<Unfinished> added_, unfinished_;  // before and after queue_step()
  // Their gradients:
  std::vector<CameraGrad> grads_;  // on the CPU
  std::vector<HostCopy> copies_;   // on a GPU
};

}  // namespace b3dgs
