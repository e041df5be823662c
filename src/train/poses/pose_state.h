// What pose refinement has learned: a part of the training state. Tensors are in host memory.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "scene/scene.h"
#include "train/poses/camera_correction.h"

namespace b3dgs {

/// A row for each of V training views. Undefined tensors: nothing has been learned.
struct PoseState {
  torch::Tensor corrections;     // [V, 6] float: rotation vector (rad), translation (world units); camera_correction.h
  torch::Tensor adam_m, adam_v;  // [V, 6] float
  torch::Tensor steps;           // [V] int32, taken with each view

  bool is_defined() const { return corrections.defined(); }
  /// Zeros.
  static PoseState make(std::int64_t n_views);
  CameraCorrection correction(std::size_t view) const;
};

/// `views`, with corrected poses where they are training views, by name.
std::vector<View> with_refined_poses(std::vector<View> views, const std::vector<View>& train, const PoseState& state);

}  // namespace b3dgs
