// What density control does to the rows of a model, as data: one function applies it to everything that has these rows.
#pragma once

#include <cstdint>
#include <functional>
#include <set>

#include "raster/torch/gaussian_tensors.h"
#include "train/density/density_statistics.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Rows after the edit: first those that are kept, in their order, then new ones.
struct RowEdit {
  torch::Tensor sources;         // [M] int64, row before the edit from which each row takes its parameters
  std::int64_t n_kept = 0;       // of the M rows
  torch::Tensor new_means;       // [M - n_kept, 3] of the new rows, in place of the source's
  torch::Tensor new_log_scales;  // [M - n_kept, 3] likewise
};

/// A tensor, contents undefined. @throws OutOfMemoryError
using AllocateTensor = std::function<torch::Tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options)>;
torch::Tensor allocate_tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options);

/// Applies edits to all tensors of a model, one after the other and in place, so that besides the model there is never
/// more than one of its tensors and the rows that are new to it.
class RowEditor {
 public:
  /// Rows are moved in pieces of about so many elements: large enough that a GPU has enough to do.
  static constexpr std::int64_t kPieceElements = 16 << 20;

  explicit RowEditor(AllocateTensor allocate = allocate_tensor, std::int64_t piece_elements = kPieceElements)
      : allocate_(std::move(allocate)), piece_elements_(piece_elements) {}

  /// Everything for which apply() needs memory: tensors with less than the edit's rows move to where there is room for
  /// n_room (at least the edit's). If this throws, the model is as it was. @throws OutOfMemoryError
  void reserve(const RowEdit& edit, std::int64_t n_room, GaussianTensors& gaussians, AdamState& adam,
               DensityStatistics& statistics);

  /// Kept rows keep parameters, moments and statistics. New rows take the parameters of their source with the edit's
  /// means and scales; their moments and statistics are 0. After reserve() of this edit it asks for no memory.
  void apply(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

 private:
  /// Rows for which a tensor has memory. One that this editor made may be the beginning of a longer one; behind the
  /// rows of others there may be anything.
  std::int64_t capacity(const torch::Tensor& tensor) const;

  AllocateTensor allocate_;
  std::int64_t piece_elements_;
  std::set<const void*> made_;  // first elements of the tensors that reserve() moved
  torch::Tensor scratch_;       // flat, of 4-byte elements
};

/// Both, with no room to spare.
void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

}  // namespace b3dgs
