// Rows moved between ranks, so that each has about the same number again.
#pragma once

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "train/ranks/rows/row_owners.h"
#include "train/ranks/rows/sharded_rows.h"

namespace b3dgs {

/// Bytes of this rank's memory that move_rows() takes beside the tensors.
std::int64_t bytes_to_move_rows(const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
                                const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

/// Replaces tensors of 32-bit elements with this rank's rows of a model, as `before` says, by its rows as `after` says.
/// Both have the same number of rows and are the same on all ranks, which call this together. One tensor after the
/// other is exchanged, or several that together are not larger than the largest or piece_bytes; a larger one in pieces.
/// An error leaves tensors with different rows: the training cannot continue.
void move_rows(Communicator& ranks, const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
               const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
