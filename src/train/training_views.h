// The training views as a step uses them: the photograph on the device, the camera with its refined pose, and both at a
// part of their size while training goes from coarse to fine (--coarse_scale).
#pragma once

#include <cstdint>
#include <vector>

#include "config/train_config.h"
#include "config/view_order.h"
#include "scene/scene.h"
#include "train/images/image_store.h"
#include "train/images/view_reducer.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {

class TrainingViews {
 public:
  /// `config`, `scene` and `poses` must outlive this. `budget_bytes`: of photographs that stay on a GPU.
  TrainingViews(const TrainConfig& config, const Scene& scene, PoseState& poses, torch::Device device,
                std::int64_t budget_bytes, const ProgressFn& progress)
      : poses(config, scene, poses),
        images(scene.train, device, budget_bytes, progress),
        config_(config),
        scene_(scene),
        reducer_(device) {}

  std::int32_t size() const { return images.size(); }

  /// The next `n` views of a training.
  std::vector<std::int32_t> upcoming(const ViewOrder& order, std::size_t n) const {
    return order.upcoming(config_.seed, images.size(), n);
  }

  /// The view for this iteration, valid until the next call; `next`: the views that will be taken after it.
  /// @throws InputError if the photograph cannot be read
  TrainView take(std::int32_t view, int iteration, const std::vector<std::int32_t>& next);

  /// The camera that take() would return.
  PinholeView camera(std::int32_t view, int iteration);

  PoseRefiner poses;
  ImageStore images;

 private:
  int scale_at(int iteration, const PinholeView& camera) const;

  const TrainConfig& config_;
  const Scene& scene_;
  ViewReducer reducer_;
};

}  // namespace b3dgs
