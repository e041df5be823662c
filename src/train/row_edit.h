// What density control does to the rows of a model, as data: one function applies it to everything that has these rows.
#pragma once

#include <cstdint>

#include "raster/gaussian_tensors.h"
#include "train/adam.h"
#include "train/density_statistics.h"

namespace b3dgs {

/// Rows after the edit: first those that are kept, in their order, then new ones.
struct RowEdit {
  torch::Tensor sources;         // [M] int64, row before the edit from which each row takes its parameters
  std::int64_t n_kept = 0;       // of the M rows
  torch::Tensor new_means;       // [M - n_kept, 3] of the new rows, in place of the source's
  torch::Tensor new_log_scales;  // [M - n_kept, 3] likewise
};

/// Kept rows keep parameters, moments and statistics. New rows take the parameters of their source with the edit's
/// means and scales; their moments and statistics are 0. Nothing is changed in place: tensors that others hold stay as
/// they were.
void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

}  // namespace b3dgs
