// Moves rows between ranks, so that each has about the same number again.
#pragma once

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "multi/rows/row_owners.h"
#include "multi/rows/sharded_rows.h"

namespace b3dgs {

/// Bytes that move_rows() needs on this rank in addition to the tensors.
std::int64_t bytes_to_move_rows(const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
                                const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

/// Moves rows between ranks: on entry, each tensor has this rank's rows according to `before`; on return, according to
/// `after`. Both have the same number of rows and are the same on all ranks, which call this together. Tensors have
/// 32-bit elements. They are exchanged in groups, large groups in pieces. After an error, tensors may have different
/// numbers of rows, and the training cannot continue.
void move_rows(Communicator& ranks, const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
               const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
