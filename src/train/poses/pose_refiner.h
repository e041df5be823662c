// Refines the poses of training cameras (--pose_opt): a step of Adam for a view's correction after each iteration that
// used it. The first and the last view by name stay as they are, since nothing else would keep the scene in its place.
//
// Steps are taken on the host: on a GPU while the next iteration is running, or earlier if that one uses the same view,
// a checkpoint is written or the cameras are saved. So results do not depend on when a step is taken.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "config/train_config.h"
#include "raster/args.h"
#include "raster/torch/torch_cuda.h"
#include "scene/scene.h"
#include "train/poses/camera_correction.h"

namespace b3dgs {

/// Limits of a correction: 3 degrees, and 3 % of the scene's extent.
CorrectionLimits pose_limits(double extent);

class PoseRefiner {
 public:
  /// All must outlive this.
  PoseRefiner(const TrainConfig& config, const Scene& scene, PoseState& state)
      : config_(config), scene_(scene), state_(state) {}

  /// Whether the iteration refines the pose of the view: it needs the camera's gradient.
  bool refines(std::int32_t view, int iteration) const;

  /// The camera with its corrected pose, for an iteration. If its last step has begun and is unfinished, waits for the
  /// GPU. Allocates what the iteration's step needs.
  CameraView camera(std::int32_t view, int iteration);

  /// Takes the gradient of an iteration (ViewStatistics::camera_grad), one or several for each step; those of the last
  /// step must be finished. Asynchronous on a GPU.
  void add_gradient(std::int32_t view, int iteration, const torch::Tensor& camera_grad);

  /// Queues the gradients added since the last call for take_queued_steps(). Before that, drop_gradients() forgets
  /// them.
  void queue_step();
  void drop_gradients() { added_.clear(); }

  /// Takes the steps along the gradients of the last queue_step(), in their order, unless that has been done; waits for
  /// the gradients. A gradient that is not finite is ignored.
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
  // Of each of them:
  std::vector<CameraGrad> grads_;  // on the CPU
  std::vector<HostCopy> copies_;   // on a GPU
};

}  // namespace b3dgs
