// The training views as a step uses them: the photograph on the device, the camera with its refined pose, and both at a
// part of their size while training goes from coarse to fine (--coarse_scale, src/config/coarse_schedule.h).
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "config/train_config.h"
#include "config/view_order.h"
#include "scene/images/image.h"
#include "scene/scene.h"
#include "train/images/image_store.h"
#include "train/images/reduce_image.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {

/// The view at 1 / scale of its size. A point that projects to (x, y) then projects to (x / scale, y / scale); pixel
/// (i, j) covers the scale x scale pixels whose mean reduce_pixel() takes. Pixels left over at the right and at the
/// bottom are outside.
CameraView reduced_camera(const CameraView& camera, int scale);

/// Reuses its buffers from step to step.
class ViewReducer {
 public:
  explicit ViewReducer(torch::Device device) : device_(device) {}

  /// The view with reduced camera, photograph and mask, valid until the next call, on the current stream. `mask` is the
  /// host's copy of view.valid, by which its reduced pixels are counted without waiting for a GPU; null if all pixels
  /// count. It must stay alive and unchanged as long as this. Scale 1 returns the view itself. Asynchronous on a GPU.
  TrainView reduce(const TrainView& view, const Image8* mask, int scale);

 private:
  std::int64_t count_valid(const Image8& mask, int scale);

  torch::Device device_;
  torch::Tensor truth_, truth_room_, valid_, valid_room_;
  std::map<std::pair<const Image8*, int>, std::int64_t> n_valid_;  // of a mask at a scale
};

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
  CameraView camera(std::int32_t view, int iteration);

  PoseRefiner poses;
  ImageStore images;

 private:
  int scale_at(int iteration, const CameraView& camera) const;

  const TrainConfig& config_;
  const Scene& scene_;
  ViewReducer reducer_;
};

/// The training views in which no Gaussian was visible when they were rendered last.
class EmptyViews {
 public:
  /// `views` must outlive this.
  explicit EmptyViews(const std::vector<View>& views) : views_(views), is_empty_(views.size()) {}

  /// Adds a view that was rendered. Returns whether it was the last view to be rendered for the first time.
  bool add(std::int32_t view, bool is_empty);
  /// Renders in this session.
  std::size_t n_rendered() const { return n_rendered_; }
  /// Returns a warning if half of the views are empty, or more than at the last warning; else "".
  std::string take_warning();

 private:
  const std::vector<View>& views_;
  std::vector<bool> is_empty_;
  std::size_t n_rendered_ = 0, n_at_warning_ = 0;
};

}  // namespace b3dgs
