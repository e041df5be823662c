// Which rank holds which rows of the model, and tensors with a row per Gaussian whose rows are spread over the ranks.
//
// The order of the model's rows is that of a training on one rank. All functions work on CPU and GPU alike, on
// contiguous tensors. Those that take a Communicator are called by all ranks together, with the same types and shapes.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "train/density/row_edit.h"

namespace b3dgs {

/// The owner of each row, the same on all ranks. At the start, blocks of rows are assigned round-robin; later a new row
/// belongs to the owner of its source, so that edits move nothing between ranks. Their shares stay about equal: in
/// trainings of 2 and 4 ranks, the largest was at most 6 % above the mean. A rank keeps its rows in the order of the
/// model.
class RowOwners {
 public:
  static constexpr std::int64_t kBlock = 32;

  /// Of an empty model, without tables.
  RowOwners() = default;

  /// @param owners  [n_rows] int16: the rank of each row
  RowOwners(int rank, int size, torch::Tensor owners);

  /// Row i belongs to block i / kBlock, and block b to rank b % size.
  static RowOwners round_robin(int rank, int size, std::int64_t n_rows, torch::Device device);

  int rank() const { return rank_; }
  int size() const { return size_; }

  /// Of the model.
  std::int64_t n_rows() const { return n_rows_; }
  std::int64_t n_own() const { return n_own_; }

  const torch::Tensor& owners() const { return owners_; }
  /// [n_own] int32, ascending: the row of the model that each own row is.
  const torch::Tensor& own() const { return own_; }
  /// The row of the model that an own row is. Waits for the device.
  std::int64_t row_of_model(std::int64_t own_row) const;
  /// [n] int64: the own row of each of these rows of the model.
  /// @param model_rows  [n] integers, rows that this rank owns
  torch::Tensor own_rows_of(const torch::Tensor& model_rows) const;

  /// After an edit: row i belongs to the owner of sources[i]. Waits for the device.
  /// @param sources  [n] int64, on the device of the tables
  RowOwners after(const torch::Tensor& sources) const;

 private:
  int rank_ = 0, size_ = 1;
  std::int64_t n_rows_ = 0, n_own_ = 0;
  torch::Tensor owners_, own_;
};

/// A RowEdit for the own rows, and the owners after it.
struct OwnRowEdit {
  RowOwners owners;
  RowEdit edit;
};
/// `edit` refers to rows of the model and is the same on every rank. A new row belongs to the rank that has its source,
/// so nothing is exchanged. Waits for the device.
OwnRowEdit own_part(const RowEdit& edit, const RowOwners& owners);

/// A contiguous copy of this rank's rows, on the device of `whole`.
torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners);

/// Rows of the model are exchanged in pieces of about this many bytes times the number of ranks, for less memory beside
/// the result.
inline constexpr std::int64_t kExchangePieceBytes = 64 << 20;

/// The whole tensor on every rank, in the order of the model: a new tensor. `owners` may be on the CPU; otherwise this
/// waits for the device.
/// @throws LogicError if `own` does not hold this rank's number of rows
torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          std::int64_t piece_bytes = kExchangePieceBytes);

/// The whole tensor in the host memory of rank 0; undefined on the other ranks. GPU memory holds one piece at a time.
torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
