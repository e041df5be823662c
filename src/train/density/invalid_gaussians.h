// Gaussians that cannot be rendered are taken out of a training, so that the others can go on.
#pragma once

#include <cstdint>

#include "train/density/density_statistics.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Removes row `named`, all rows in which a parameter or a moment is not finite, and where the named one is wider than
/// 1e4 times the scene's `extent` all that are as wide. Returns how many that were.
std::int64_t remove_bad_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                  DensityStatistics& statistics);

}  // namespace b3dgs
