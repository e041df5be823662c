// What the stages of a training step cannot go below on one H200: derived from the bytes and instructions that they
// need, never measured.
#pragma once

#include <cstdint>
#include <optional>

#include "raster/stages.h"

namespace b3dgs {

struct StepSize {
  std::int64_t n_gaussians = 0;
  int sh_degree = 3;    // of the colours that are rendered
  double n_pixels = 0;  // of a view
};

/// What the derivation takes for granted, for whoever reads the figures.
inline constexpr const char* kStepFloorAssumptions =
    "derived for one H200, not measured: 4.3 TB/s, 1.045e12 warp instructions/s, no gaps; 40 % of the Gaussians seen, "
    "2.25 tiles each; blending work per pixel as in an evenly filled image";

/// Milliseconds; nothing for stages without a floor.
std::optional<double> step_floor_ms(Stage stage, const StepSize& size);

}  // namespace b3dgs
