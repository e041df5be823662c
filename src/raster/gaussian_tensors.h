// One tensor per parameter group: parameters, gradients and moments all have this form.
#pragma once

#include <torch/types.h>

#include <array>

namespace b3dgs {

/// Groups in the order of every file and loop.
struct GaussianTensors {
  torch::Tensor means;            // [N, 3] world
  torch::Tensor log_scales;       // [N, 3]
  torch::Tensor quats;            // [N, 4] w x y z
  torch::Tensor logit_opacities;  // [N]
  torch::Tensor sh0;              // [N, 1, 3]
  torch::Tensor shN;              // [N, K-1, 3]

  std::int64_t size() const { return means.defined() ? means.size(0) : 0; }

  static constexpr std::array<const char*, 6> kNames{"means", "log_scales", "quats", "logit_opacities", "sh0", "shN"};
  std::array<torch::Tensor*, 6> all() { return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN}; }
  std::array<const torch::Tensor*, 6> all() const {
    return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN};
  }
};

}  // namespace b3dgs
