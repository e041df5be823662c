// Additions and removals of Gaussians whose rows are spread over the ranks.
#pragma once

#include <cstdint>

#include "dist/communicator.h"
#include "train/density/row_edit.h"
#include "train/ranks/sharded_rows.h"

namespace b3dgs {

/// density/row_edit.h's apply_row_edit() for tensors with this rank's rows of a model of n_global_before Gaussians.
/// `edit` refers to global rows and is the same on every rank, on the device of the tensors. Afterwards, each rank
/// holds its rows of the tensors that that function would make of the whole model. All ranks call this together.
///
/// Beside the model and the edit, memory holds a copy of edit.sources, one tensor of the model as it is afterwards, or
/// several that together are not larger or at most piece_bytes, and two pieces of piece_bytes. An error after the first
/// checks leaves tensors with different numbers of rows: the training cannot continue.
/// @throws LogicError on all ranks, with nothing changed, if the edit does not fit the rows or the ranks disagree on
/// it; OutOfMemoryError
void apply_row_edit(Communicator& ranks, const RowEdit& edit, std::int64_t n_global_before, GaussianTensors& gaussians,
                    AdamState& adam, DensityStatistics& statistics, std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
