// What density control records of each Gaussian between two rounds.
#pragma once

#include <cstdint>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

struct DensityStatistics {
  /// A further column of one strategy.
  struct Column {
    std::string name;
    torch::Tensor values;  // [N] float
  };

  // [N] float, sum over views of the norm of dL/d(projected centre) in normalised device coordinates, the unit of the
  // original 3DGS threshold: dL/dpx times half the image size.
  torch::Tensor grad_norm_sum;
  torch::Tensor view_count;  // [N] int32, views that saw the Gaussian
  torch::Tensor max_radii;   // [N] int32, px, largest radius in any of them
  std::vector<Column> extra;

  /// All columns and their names, in the order of a checkpoint.
  std::vector<torch::Tensor*> all() {
    std::vector<torch::Tensor*> columns{&grad_norm_sum, &view_count, &max_radii};
    for (Column& column : extra) columns.push_back(&column.values);
    return columns;
  }
  std::vector<const torch::Tensor*> all() const {
    const std::vector<torch::Tensor*> columns = const_cast<DensityStatistics*>(this)->all();
    return {columns.begin(), columns.end()};
  }
  std::vector<std::string> names() const {
    std::vector<std::string> names{"grad_norm_sum", "view_count", "max_radii"};
    for (const Column& column : extra) names.push_back(column.name);
    return names;
  }
};

/// Zeros, without extra columns.
DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device);

/// Calls visit(tensor) for each tensor with a row per Gaussian.
template <class Gaussians, class Adam, class Statistics, class Visit>
void visit_rows(Gaussians& gaussians, Adam& adam, Statistics& statistics, Visit&& visit) {
  for (auto* group : {&gaussians, &adam.m, &adam.v}) {
    for (auto* tensor : group->all()) visit(*tensor);
  }
  for (auto* column : statistics.all()) visit(*column);
}

/// Elements of a row.
std::int64_t row_elements(const torch::Tensor& tensor);

// Additions and removals of Gaussians as data, applied to every tensor with one row per Gaussian.

/// Rows after the edit: first the kept ones, in ascending order, then the new ones, whose Adam moments are 0.
struct RowEdit {
  torch::Tensor sources;              // [M] int64, row before the edit whose parameters each row takes
  std::int64_t n_kept = 0;            // of the M rows
  torch::Tensor new_means;            // [M - n_kept, 3] of the new rows, instead of the source's
  torch::Tensor new_log_scales;       // [M - n_kept, 3] of the new rows, instead of the source's
  torch::Tensor new_logit_opacities;  // [M - n_kept] of the new rows; undefined: the source's
};

/// The edit that keeps these rows [n] int64, ascending, and adds none. `floats`: type and device of parameters.
inline RowEdit keep_rows(const torch::Tensor& rows, const torch::TensorOptions& floats) {
  return {rows, rows.size(0), torch::empty({0, 3}, floats), torch::empty({0, 3}, floats), {}};
}

/// The rows where `mask` [N] is true, ascending.
inline torch::Tensor rows_of(const torch::Tensor& mask) {
  return mask.nonzero().flatten();
}

/// The n of `rows` with the largest `keys`; of equal keys, the first.
inline torch::Tensor largest_rows(const torch::Tensor& rows, const torch::Tensor& keys, std::int64_t n) {
  const torch::Tensor order = std::get<1>(torch::sort(keys, /*stable=*/true, /*dim=*/0, /*descending=*/true));
  return rows.index_select(0, order.slice(0, 0, n));
}

/// An uninitialised tensor. @throws OutOfMemoryError
using AllocateTensor = std::function<torch::Tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options)>;
torch::Tensor allocate_tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options);

/// Applies edits to all tensors of a model, one after the other and in place: beside the model, memory holds at most
/// one of its tensors and that tensor's new rows.
class RowEditor {
 public:
  /// Rows are moved in pieces of about `piece_elements`: enough to keep a GPU busy.
  explicit RowEditor(AllocateTensor allocate = allocate_tensor, std::int64_t piece_elements = 16 << 20)
      : allocate_(std::move(allocate)), piece_elements_(piece_elements) {}

  /// Allocates everything that apply() needs: tensors with capacity for fewer rows than the edit's are reallocated with
  /// capacity for n_room (at least the edit's). If this throws, the model is unchanged. @throws OutOfMemoryError
  void reserve(const RowEdit& edit, std::int64_t n_room, GaussianTensors& gaussians, AdamState& adam,
               DensityStatistics& statistics);

  /// Kept rows keep parameters, moments and statistics. New rows take the parameters of their source, but the edit's
  /// means, scales and opacities; their statistics and moments are 0. `gaussians.filters` become undefined. Call
  /// reserve() with this edit first; this allocates nothing.
  void apply(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

 private:
  /// Rows that fit into a tensor's memory. Tensors that this editor allocated may have spare capacity; memory behind
  /// other tensors may be in use.
  std::int64_t capacity(const torch::Tensor& tensor) const;

  AllocateTensor allocate_;
  std::int64_t piece_elements_;
  std::set<const void*> made_;  // data pointers of the tensors that reserve() allocated
  torch::Tensor scratch_;       // flat, of 4-byte elements
};

/// reserve() and apply(), without spare capacity.
void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

// Removes Gaussians that cannot be rendered, so that training can continue with the others.

/// What tells which Gaussians are invalid.
struct GaussianWidths {
  torch::Tensor is_finite;  // [N] bool, whether all parameters and Adam moments are
  torch::Tensor largest;    // [N] logarithm of the largest scale
};
GaussianWidths gaussian_widths(const GaussianTensors& gaussians, const AdamState& adam);

/// The edit that remove_invalid_gaussians() applies.
RowEdit edit_without_invalid(std::int64_t named, double extent, const GaussianWidths& widths);

/// Removes row `named`, and all rows in which a parameter or an Adam moment is not finite. If the named row is wider
/// than 1e4 times the scene `extent` (world units), all rows at least as wide are removed too. Returns how many rows
/// were removed.
std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics);

}  // namespace b3dgs
