// Guarantees of every reader of Gaussians for accepted files.
#pragma once

#include <cmath>

#include "core/check.h"
#include "model/formats/splat_formats.h"

namespace b3dgs::fuzz {

/// @throws LogicError if arrays differ in length, or a value is not finite
inline void check_splats(const SplatCloud& cloud) {
  const auto n = static_cast<std::size_t>(cloud.size());
  B3DGS_CHECK(cloud.sh_degree >= 0 && cloud.sh_degree <= 3, "SH degree ", cloud.sh_degree);
  B3DGS_CHECK(cloud.means.size() == 3 * n && cloud.log_scales.size() == 3 * n && cloud.quats.size() == 4 * n &&
                  cloud.sh0.size() == 3 * n &&
                  cloud.shN.size() == 3 * n * static_cast<std::size_t>(sh_coefficient_count(cloud.sh_degree) - 1),
              "the arrays of ", n, " Gaussians differ in length");
  for (const std::vector<float>* values :
       {&cloud.means, &cloud.log_scales, &cloud.quats, &cloud.logit_opacities, &cloud.sh0, &cloud.shN}) {
    for (const float value : *values) B3DGS_CHECK(std::isfinite(value), "expected a finite value, found ", value);
  }
}

}  // namespace b3dgs::fuzz
