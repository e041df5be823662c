// Which rank holds which rows of the model.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "train/density/row_edit.h"

namespace b3dgs {

/// The owner of each row, the same on all ranks. At the start, blocks of rows are assigned round-robin; later a new row
/// belongs to the owner of its source, so that edits move nothing between ranks. A rank keeps its rows in the order of
/// the model.
class RowOwners {
 public:
  static constexpr std::int64_t kBlock = 32;

  /// Of an empty model, without tables.
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
  /// How many of rows [begin, end) of the model each rank holds. Waits for the device.
  std::vector<std::int64_t> count(std::int64_t begin, std::int64_t end) const;
  /// The most rows that a rank holds.
  std::int64_t n_most() const;
  /// Whether the largest part is over 1.05 times the largest part of round_robin().
  bool are_uneven() const;

  /// [n_rows] int16: the rank of each row.
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
  RowOwners(int rank, int size, torch::Tensor owners);

  int rank_ = 0, size_ = 1;
  std::int64_t n_rows_ = 0;
  std::vector<std::int64_t> n_of_ranks_{0};
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

}  // namespace b3dgs
