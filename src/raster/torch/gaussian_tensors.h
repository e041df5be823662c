// One tensor per parameter group: parameters, gradients and moments all have this form.
#pragma once

#include <torch/types.h>

#include <array>
#include <cstdint>

#include "core/check.h"
#include "raster/constants.h"

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

/// Degree of harmonics that shN has room for. @throws LogicError if it holds another number of them.
inline int sh_degree_max_of(const GaussianTensors& gaussians) {
  const std::int64_t k = gaussians.shN.size(1) + 1;
  for (int degree = 0; degree <= kShDegreeMax; ++degree) {
    if ((degree + 1) * (degree + 1) == k) return degree;
  }
  throw LogicError(detail::concat("shN holds ", k - 1, " coefficients; 0, 3, 8 or 15 belong to a degree"));
}

}  // namespace b3dgs
