// Views at a part of their size, for training from coarse to fine (src/config/coarse_schedule.h).
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <map>

#include "scene/images/image.h"
#include "train/images/image_store.h"
#include "train/images/reduce_image.h"

namespace b3dgs {

/// The view at 1 / scale of its size. A point that projects to (x, y) then projects to (x / scale, y / scale); pixel
/// (i, j) covers the scale x scale pixels whose mean reduce_pixel() takes. Pixels left over at the right and at the
/// bottom are outside.
PinholeView reduced_camera(const PinholeView& camera, int scale);

/// Writes all reduced pixels on the CPU. The result does not depend on the number of threads.
void reduce_image(const ReduceImageArgs& args);

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
  int counted_scale_ = 1;
  std::map<const Image8*, std::int64_t> n_valid_;  // at counted_scale_
};

}  // namespace b3dgs
