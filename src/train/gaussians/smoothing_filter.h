// 3D smoothing filters of a model's Gaussians (--antialiasing; raster/math/antialiasing.h).
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "raster/torch/rasterizer.h"
#include "train/gaussians/smoothing_filter_args.h"

namespace b3dgs {

/// Computes the filters of all Gaussians from the training views.
class SmoothingFilter {
 public:
  /// `near_plane` is in world units.
  SmoothingFilter(const std::vector<CameraView>& views, float near_plane, torch::Device device);

  /// Replaces a non-negative float tensor [1] by its maximum over all ranks.
  using FindLargest = std::function<void(torch::Tensor& largest)>;

  /// Sets `gaussians.filters` [N] in world units. Asynchronous on a GPU. Gaussians that no view sees get the filter of
  /// the largest pixel. With several ranks, `find_largest` finds the largest pixel of the whole model.
  void compute(GaussianTensors& gaussians, const FindLargest& find_largest = {});

 private:
  float near_plane_;
  std::int32_t n_views_;
  torch::Tensor views_;  // [bytes] uint8, FilterView each
  torch::Tensor storage_;
};

}  // namespace b3dgs
