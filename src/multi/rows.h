// The distribution of the model's rows over the ranks, and operations on tensors with one row per Gaussian that are
// distributed in this way.
//
// The order of the model's rows is that of a training on one rank. All functions work on CPU and GPU alike, on
// contiguous tensors. Functions that take a Communicator are called by all ranks together, with the same types and
// shapes.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "train/density/row_edit.h"

namespace b3dgs {

/// The owner of each row, the same on all ranks. At the start, blocks of rows are assigned round-robin. Later, a new
/// row belongs to the owner of its source, so that edits move nothing between ranks. The ranks' shares stay about
/// equal. In trainings on 2 and 4 ranks, the largest was at most 6 % above the mean. A rank keeps its rows in the order
/// of the model.
class RowOwners {
 public:
  static constexpr std::int64_t kBlock = 32;

  /// Makes the owners of an empty model, without tables.
  RowOwners() = default;

  /// @param owners  [n_rows] int16: the rank of each row
  RowOwners(int rank, int size, torch::Tensor owners);

  /// Assigns row i to block i / kBlock, and block b to rank b % size.
  static RowOwners round_robin(int rank, int size, std::int64_t n_rows, torch::Device device);

  int rank() const { return rank_; }
  int size() const { return size_; }

  /// Returns the number of rows of the model.
  std::int64_t n_rows() const { return n_rows_; }
  /// Returns the number of rows that this rank owns.
  std::int64_t n_own() const { return n_own_; }

  const torch::Tensor& owners() const { return owners_; }
  /// Returns the indices in the model of this rank's rows, [n_own] int32, ascending.
  const torch::Tensor& own() const { return own_; }
  /// Returns the index in the model of a row of this rank. Waits for the device.
  std::int64_t row_of_model(std::int64_t own_row) const;
  /// Returns the index among this rank's rows of each of these rows of the model, [n] int64.
  /// @param model_rows  [n] integers, rows that this rank owns
  torch::Tensor own_rows_of(const torch::Tensor& model_rows) const;

  /// Returns the owners after an edit, where row i belongs to the owner of sources[i]. Waits for the device.
  /// @param sources  [n] int64, on the device of the tables
  RowOwners after(const torch::Tensor& sources) const;

 private:
  int rank_ = 0, size_ = 1;
  std::int64_t n_rows_ = 0, n_own_ = 0;
  torch::Tensor owners_, own_;
};

/// A RowEdit for this rank's rows, and the owners after it.
struct OwnRowEdit {
  RowOwners owners;
  RowEdit edit;
};
/// Returns this rank's part of `edit`, which refers to rows of the model and is the same on every rank. A new row
/// belongs to the rank that owns its source, so nothing is exchanged. Waits for the device.
OwnRowEdit own_part(const RowEdit& edit, const RowOwners& owners);

/// Returns a contiguous copy of this rank's rows, on the device of `whole`.
torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners);

/// Rows of the model are exchanged in pieces of about this many bytes times the number of ranks, to limit the memory
/// beside the result.
inline constexpr std::int64_t kExchangePieceBytes = 64 << 20;

/// Returns the whole tensor on every rank, in the order of the model, as a new tensor. `owners` may be on the CPU.
/// Otherwise this waits for the device.
/// @throws LogicError if `own` does not have this rank's number of rows
torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          std::int64_t piece_bytes = kExchangePieceBytes);

/// Returns the whole tensor in the host memory of rank 0, and an undefined tensor on the other ranks. GPU memory
/// contains one piece at a time.
torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes = kExchangePieceBytes);

}  // namespace b3dgs
