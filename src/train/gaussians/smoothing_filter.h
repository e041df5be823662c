// The 3D smoothing filters of a model's Gaussians (raster/math/antialiasing.h).
#pragma once

#include <cstdint>
#include <vector>

#include "raster/torch/gaussian_tensors.h"
#include "train/gaussians/smoothing_filter_args.h"

namespace b3dgs {

/// Computes the filters of a model for a set of training views.
class SmoothingFilter {
 public:
  SmoothingFilter(const std::vector<PinholeView>& views, float near_plane, torch::Device device);

  /// Sets `gaussians.filters`. Asynchronous on a GPU.
  void compute(GaussianTensors& gaussians);

 private:
  float near_plane_;
  std::int32_t n_views_;
  torch::Tensor views_;  // [bytes] uint8, FilterView each
  torch::Tensor largest_, storage_;
};

}  // namespace b3dgs
