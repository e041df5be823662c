// Additions and removals of Gaussians whose rows are spread over the ranks.
#pragma once

#include "dist/communicator.h"
#include "multi/rows/row_owners.h"
#include "train/density/row_edit.h"

namespace b3dgs {

/// Numbers that tell edits apart.
struct SourceNumbers {
  std::int64_t first = 0, last = 0;  // smallest and largest source
  std::int64_t weighted_sum = 0;
};
/// Waits for the device once.
SourceNumbers source_numbers(const RowEdit& edit);

/// `edit` refers to rows of the model and is the same on every rank, on the device of the tensors, of which each rank
/// has its own rows. Allocates nothing on the device.
/// @throws LogicError on all ranks if the edit does not fit the rows or the ranks disagree on it
void check_row_edit(Communicator& ranks, const RowEdit& edit, const SourceNumbers& numbers, const RowOwners& owners,
                    GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

/// An edit for the own rows, and the owners after it.
struct OwnRowEdit {
  RowOwners owners;
  RowEdit edit;
};
/// A new row belongs to the rank that has its source, so nothing is exchanged. Waits for the device.
OwnRowEdit own_part(const RowEdit& edit, const RowOwners& owners);

/// check_row_edit(), then density/row_edit.h's apply_row_edit() of the own part. Returns the owners after the edit.
/// @throws LogicError on all ranks, with nothing changed; OutOfMemoryError on one rank
RowOwners apply_row_edit(Communicator& ranks, const RowEdit& edit, const RowOwners& owners, GaussianTensors& gaussians,
                         AdamState& adam, DensityStatistics& statistics);

}  // namespace b3dgs
