// Removes Gaussians that cannot be rendered, so that training can continue with the others.
#pragma once

#include <cstdint>

#include "train/density/density_statistics.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// What tells which Gaussians are invalid.
struct GaussianWidths {
  torch::Tensor is_finite;  // [N] bool, whether all parameters and Adam moments are
  torch::Tensor largest;    // [N] logarithm of the largest scale
};
GaussianWidths gaussian_widths(const GaussianTensors& gaussians, const AdamState& adam);

/// The edit that remove_invalid_gaussians() applies.
RowEdit edit_without_invalid(std::int64_t named, double extent, const GaussianWidths& widths);

/// Removes row `named`, and all rows in which a parameter or an Adam moment is not finite. If the named row is wider
/// than 1e4 times the scene `extent` (world units), all rows at least as wide are removed too. Returns how many rows
/// were removed.
std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics);

}  // namespace b3dgs
