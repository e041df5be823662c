// Training views as a step uses them: the photograph on the device, and the camera with its refined pose. While
// training goes from coarse to fine (--coarse_scale, src/config/coarse_schedule.h), both are reduced in size.
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

/// Returns the camera for an image reduced by the factor `scale`. A point that projects to (x, y) then projects to (x /
/// scale, y / scale), and pixel (i, j) covers the scale x scale pixels that reduce_pixel() averages. Remaining pixels
/// at the right and the bottom are cut off.
CameraView reduced_camera(const CameraView& camera, int scale);

/// Reduces views. Buffers are reused from step to step.
class ViewReducer {
 public:
  explicit ViewReducer(torch::Device device) : device_(device) {}

  /// Returns the view with reduced camera, photograph and mask, valid until the next call, on the current stream.
  /// `mask` is the host's copy of view.valid, or null if all pixels count. The reduced pixels are counted on it without
  /// waiting for a GPU. It must outlive this object unchanged. Scale 1 returns the view itself. Asynchronous on a GPU.
  TrainView reduce(const TrainView& view, const Image8* mask, int scale);

 private:
  std::int64_t count_valid(const Image8& mask, int scale);

  torch::Device device_;
  torch::Tensor truth_, truth_room_, valid_, valid_room_;
  std::map<std::pair<const Image8*, int>, std::int64_t> n_valid_;  // by mask and scale
};

class TrainingViews {
 public:
  /// `config`, `scene` and `poses` must outlive this object. `budget_bytes` limits the photographs that stay on a GPU.
  TrainingViews(const TrainConfig& config, const Scene& scene, PoseState& poses, torch::Device device,
                std::int64_t budget_bytes, const ProgressFn& progress)
      : poses(config, scene, poses),
        images(scene.train, device, budget_bytes, progress),
        config_(config),
        scene_(scene),
        reducer_(device) {}

  std::int32_t size() const { return images.size(); }

  /// Returns the next `n` views in this order.
  std::vector<std::int32_t> upcoming(const ViewOrder& order, std::size_t n) const {
    return order.upcoming(config_.seed, images.size(), n);
  }

  /// Returns the view for this iteration, valid until the next call. `next` lists the views that will be used after it,
  /// to be read ahead.
  /// @throws InputError if the photograph cannot be read
  TrainView take(std::int32_t view, int iteration, const std::vector<std::int32_t>& next);

  /// Returns the camera that take() would return.
  CameraView camera(std::int32_t view, int iteration);

  PoseRefiner poses;
  ImageStore images;

 private:
  int scale_at(int iteration, const CameraView& camera) const;

  const TrainConfig& config_;
  const Scene& scene_;
  ViewReducer reducer_;
};

/// Counts the training views in which no Gaussian was visible when they were last rendered.
class EmptyViews {
 public:
  /// `views` must outlive this object.
  explicit EmptyViews(const std::vector<View>& views) : views_(views), is_empty_(views.size()) {}

  /// Records a rendered view. Returns true if as many views have been rendered as there are training views.
  bool add(std::int32_t view, bool is_empty);
  /// Returns the number of views rendered in this session.
  std::size_t n_rendered() const { return n_rendered_; }
  /// Returns a warning if half of the views are empty, or more than at the last warning. Otherwise returns "".
  std::string take_warning();

 private:
  const std::vector<View>& views_;
  std::vector<bool> is_empty_;
  std::size_t n_rendered_ = 0, n_at_warning_ = 0;
};

}  // namespace b3dgs
