// Which rank holds which rows of the model.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "train/density/row_edit.h"

namespace b3dgs {

/// The owner of each row, the same on all ranks. At the start, blocks of rows are assigned round-robin; later a new row
/// belongs to the owner of its source, so that edits move nothing between ranks. A rank keeps its rows in the order of
/// the model. With one rank, which holds all rows, there are no tables.
class RowOwners {
 public:
  static constexpr std::int64_t kBlock = 32;

  /// One rank and an empty model.
  RowOwners() = default;

  /// Row i belongs to block i / kBlock, and block b to rank b % size.
  static RowOwners round_robin(int rank, int size, std::int64_t n_rows, torch::Device device);

  int rank() const { return rank_; }
  int size() const { return size_; }

  /// Of the model.
  std::int64_t n_rows() const { return n_rows_; }
  std::int64_t n_own() const { return n_of_ranks_[static_cast<std::size_t>(rank_)]; }
  /// How many rows each rank holds.
  const std::vector<std::int64_t>& n_of_ranks() const { return n_of_ranks_; }
  /// The most rows that a rank holds.
  std::int64_t n_most() const;
  /// Whether the largest part is over 1.05 times the largest part of round_robin().
  bool are_uneven() const;

  /// [n_rows] int16: the rank of each row; undefined with one rank.
  const torch::Tensor& owners() const { return owners_; }
  /// [n_own] int32, ascending: the row of the model that each own row is; undefined with one rank.
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
  RowOwners(int rank, int size, torch::Tensor owners);

  int rank_ = 0, size_ = 1;
  std::int64_t n_rows_ = 0;
  std::vector<std::int64_t> n_of_ranks_{0};
  torch::Tensor owners_, own_;
};

// Additions and removals of Gaussians whose rows are spread over the ranks.

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
