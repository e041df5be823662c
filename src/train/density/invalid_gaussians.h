// Removes Gaussians that cannot be rendered, so that training can continue with the others.
#pragma once

#include <cstdint>

#include "train/density/density_statistics.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Removes row `named`, and all rows in which a parameter or an Adam moment is not finite. If the named row is wider
/// than 1e4 times the scene `extent` (world units), all rows at least as wide are removed too. Returns how many rows
/// were removed.
std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics);

}  // namespace b3dgs
