// One tensor per parameter group. Parameters, gradients and Adam's moments all have this structure.
#pragma once

#include <torch/types.h>

#include <array>
#include <cstdint>

#include "core/check.h"
#include "raster/constants.h"

namespace b3dgs {

/// The groups, in the order that files and loops use. K = (SH degree + 1)^2.
struct GaussianTensors {
  torch::Tensor means;            // [N, 3] world space
  torch::Tensor log_scales;       // [N, 3]
  torch::Tensor quats;            // [N, 4] w x y z
  torch::Tensor logit_opacities;  // [N]
  torch::Tensor sh0;              // [N, 1, 3]
  torch::Tensor shN;              // [N, K-1, 3]

  // [N] world units, standard deviation of the 3D smoothing filter (raster/math/antialiasing.h). Derived from the means
  // and the training views, and not a parameter; undefined: no filter.
  torch::Tensor filters{};

  std::int64_t size() const { return means.defined() ? means.size(0) : 0; }

  static constexpr std::array<const char*, 6> kNames{"means", "log_scales", "quats", "logit_opacities", "sh0", "shN"};
  std::array<torch::Tensor*, 6> all() { return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN}; }
  std::array<const torch::Tensor*, 6> all() const {
    return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN};
  }
};

/// SH degree that shN is allocated for. @throws LogicError if its number of coefficients belongs to no degree
inline int sh_degree_of(const GaussianTensors& gaussians) {
  const std::int64_t k = gaussians.shN.size(1) + 1;
  for (int degree = 0; degree <= kShDegreeMax; ++degree) {
    if ((degree + 1) * (degree + 1) == k) return degree;
  }
  throw LogicError(detail::concat("shN has ", k - 1, " coefficients, expected 0, 3, 8 or 15"));
}

}  // namespace b3dgs
