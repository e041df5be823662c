// Refines the poses of training cameras (--pose_opt): a step of Adam for a view's correction after each iteration that
// used it. The first and the last view by name stay as they are, since nothing else would keep the scene in its place.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "config/train_config.h"
#include "raster/args.h"
#include "scene/scene.h"
#include "train/poses/pose_state.h"

namespace b3dgs {

/// Limits of a correction: 3 degrees, and 3 % of the scene's extent.
CorrectionLimits pose_limits(double extent);

class PoseRefiner {
 public:
  /// All must outlive this.
  PoseRefiner(const TrainConfig& config, const Scene& scene, PoseState& state);
  ~PoseRefiner();

  /// Whether the iteration refines the pose of the view: it needs the camera's gradient.
  bool refines(std::int32_t view, int iteration) const;

  /// The camera with its corrected pose. If its last step is unfinished, waits for the GPU.
  PinholeView camera(std::int32_t view);

  /// Takes the gradient of an iteration (ViewStatistics::camera_grad); the last step must be finished. Asynchronous on
  /// a GPU.
  void add_gradient(std::int32_t view, int iteration, const torch::Tensor& camera_grad);

  /// Takes the step along the last gradient, unless that has been done; waits for the gradient. A gradient that is not
  /// finite is ignored.
  void finish_step();

 private:
  struct Unfinished {
    std::int32_t view = 0;
    int iteration = 0;
  };
  void take_step(std::int32_t view, int iteration, const std::array<double, kCameraGradients>& grad);

  const TrainConfig& config_;
  const Scene& scene_;
  PoseState& state_;
  std::optional<Unfinished> unfinished_;
  std::array<double, kCameraGradients> grad_{};  // on the CPU
  struct Reader;
  std::unique_ptr<Reader> reader_;  // on a GPU
};

}  // namespace b3dgs
