// Tensors with a row per Gaussian, whose rows are spread over the ranks (row_owners.h).
//
// The order of the model's rows is that of a training on one rank. All functions work on CPU and GPU alike. Those that
// take a Communicator are called by all ranks together.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "dist/communicator.h"
#include "multi/rows/row_owners.h"

namespace b3dgs {

/// A contiguous copy of this rank's rows, on the device of `whole`.
torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners);

/// Rows of the model are exchanged in pieces of about this many bytes times the number of ranks, for less memory beside
/// the result.
inline constexpr std::int64_t kExchangePieceBytes = 64 << 20;

/// The whole tensor on every rank, in the order of the model. A new tensor; with one rank, `own` itself.
/// @throws LogicError on all ranks if they disagree on the number of rows of a rank, type or shape, or if one does not
/// hold its number of rows
torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          std::int64_t piece_bytes = kExchangePieceBytes);

/// The same for several tensors of 32-bit elements, in one exchange, or one for each piece of piece_bytes.
std::vector<torch::Tensor> gather_rows(Communicator& ranks, const std::vector<torch::Tensor>& own,
                                       const RowOwners& owners, std::int64_t piece_bytes = kExchangePieceBytes);

/// The same piece by piece: on rank 0, calls take() with the rows in the order of the model, in host memory, which
/// holds two pieces of each rank at a time. An exception of take() is thrown when all pieces have been exchanged.
void stream_rows_to_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          const std::function<void(const torch::Tensor& rows)>& take,
                          std::int64_t piece_bytes = kExchangePieceBytes);

/// The same in the host memory of rank 0; undefined on the other ranks. GPU memory holds one piece at a time.
torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes = kExchangePieceBytes);

/// What the rank that renders a view tells all ranks: view v is rendered by rank renderers[v]. `rendered` has a row for
/// each view that this rank renders, in their order. Returns a row for each view. One exchange.
torch::Tensor gather_view_rows(Communicator& ranks, const torch::Tensor& rendered, const std::vector<int>& renderers);

/// 32-bit words of one row.
std::int64_t words_per_row(const torch::Tensor& rows);
/// The same memory as [n, words_per_row()] int32. Contiguous tensors of 32-bit elements.
torch::Tensor as_words(const torch::Tensor& rows);

/// Bytes of one row. Contiguous tensors of any type and shape.
std::int64_t bytes_per_row(const torch::Tensor& rows);

/// How many rows of `bytes` each fit into piece_bytes: at least one.
std::int64_t rows_per_piece(std::int64_t bytes, std::int64_t piece_bytes);

/// @throws LogicError on all ranks, with the first cause that is not empty; returns if all are. For checks that may
/// fail on some ranks only: a rank that threw alone would leave the others waiting.
void throw_together(Communicator& ranks, const std::string& label, const std::string& cause);

/// check_agreement() and throw_together() in one exchange.
void check_together(Communicator& ranks, const std::string& what, const std::vector<std::int64_t>& numbers,
                    const std::string& cause);

/// @throws LogicError on all ranks, naming `what`, unless the numbers are the same on all of them
void check_agreement(Communicator& ranks, const std::string& what, const std::vector<std::int64_t>& numbers);

// Moves rows between ranks, so that each has about the same number again.

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
