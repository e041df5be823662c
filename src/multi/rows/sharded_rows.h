// Tensors with a row per Gaussian, whose rows are spread over the ranks (row_owners.h).
//
// The order of the model's rows is that of a training on one rank. All functions work on CPU and GPU alike, on
// contiguous tensors. Those that take a Communicator are called by all ranks together, with the same types and shapes.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "multi/rows/row_owners.h"

namespace b3dgs {

/// A contiguous copy of this rank's rows, on the device of `whole`.
torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners);

/// Rows of the model are exchanged in pieces of about this many bytes times the number of ranks, for less memory beside
/// the result.
inline constexpr std::int64_t kExchangePieceBytes = 64 << 20;

/// The whole tensors on every rank, in the order of the model: new tensors, in one exchange, or one for each piece.
/// @param own  of 32-bit elements, at least one tensor
/// @throws LogicError if one does not hold this rank's number of rows
std::vector<torch::Tensor> gather_rows(Communicator& ranks, const std::vector<torch::Tensor>& own,
                                       const RowOwners& owners, std::int64_t piece_bytes = kExchangePieceBytes);

/// The whole tensor, of any type, in the host memory of rank 0; undefined on the other ranks. GPU memory holds one
/// piece at a time.
torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes = kExchangePieceBytes);

/// What the rank that renders a view tells all ranks: view v is rendered by rank renderers[v]. `rendered` has a row for
/// each view that this rank renders, in their order. Returns a row for each view. One exchange.
torch::Tensor gather_view_rows(Communicator& ranks, const torch::Tensor& rendered, const std::vector<int>& renderers);

/// Bytes that move_rows() needs on this rank in addition to the tensors.
std::int64_t bytes_to_move_rows(const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
                                const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

/// Moves rows between ranks, so that each has about the same number again: on entry, each tensor has this rank's rows
/// according to `before`; on return, according to `after`. Both have the same number of rows and are the same on all
/// ranks. Tensors are moved one after the other, large ones in pieces. After an error, they may have different numbers
/// of rows, and the training cannot continue.
void move_rows(Communicator& ranks, const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
               const RowOwners& after, std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
