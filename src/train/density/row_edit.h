// Statistics of each Gaussian between two rounds of density control, and the edits that add and remove Gaussians.
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
  /// An additional column of one strategy.
  struct Column {
    std::string name;
    torch::Tensor values;  // [N] float
  };

  // The next three are filled by strategy default only.
  // [N] float, sum over views of the norm of dL/d(projected centre) in normalised device coordinates, which is dL/dpx
  // times half the image size. The threshold of the original 3DGS has this unit.
  torch::Tensor grad_norm_sum;
  torch::Tensor view_count;  // [N] int32, number of views in which the Gaussian was visible
  torch::Tensor max_radii;   // [N] int32, px, largest radius in any of these views
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

/// Returns zero statistics without additional columns.
DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device);

/// Calls visit(tensor) for each tensor with a row per Gaussian.
template <class Gaussians, class Adam, class Statistics, class Visit>
void visit_rows(Gaussians& gaussians, Adam& adam, Statistics& statistics, Visit&& visit) {
  for (auto* group : {&gaussians, &adam.m, &adam.v}) {
    for (auto* tensor : group->all()) visit(*tensor);
  }
  if (adam.directions.defined()) visit(adam.directions);
  for (auto* column : statistics.all()) visit(*column);
}

/// Returns the number of elements per row.
std::int64_t row_elements(const torch::Tensor& tensor);

// Row edits describe which Gaussians are added and removed. They are applied to every tensor that has one row per
// Gaussian.

/// The rows after the edit. Kept rows come first, in ascending order, and new rows, whose Adam moments are 0, come
/// after them.
struct RowEdit {
  torch::Tensor sources;              // [M] int64, index before the edit of the row that each row is copied from
  std::int64_t n_kept = 0;            // number of kept rows, at most M
  torch::Tensor new_means;            // [M - n_kept, 3] means of the new rows, instead of those of the sources
  torch::Tensor new_log_scales;       // [M - n_kept, 3] their scales
  torch::Tensor new_logit_opacities;  // [M - n_kept] their opacities; undefined: those of the sources
};

/// Returns the edit that keeps the rows `rows` ([n] int64, ascending) and adds none. `floats` is the type and device of
/// the parameters.
inline RowEdit keep_rows(const torch::Tensor& rows, const torch::TensorOptions& floats) {
  return {rows, rows.size(0), torch::empty({0, 3}, floats), torch::empty({0, 3}, floats), {}};
}

/// Returns the indices at which `mask` [N] is true, ascending.
inline torch::Tensor rows_of(const torch::Tensor& mask) {
  return mask.nonzero().flatten();
}

/// Returns the n entries of `rows` with the largest `keys`. If keys are equal, earlier entries come first.
inline torch::Tensor largest_rows(const torch::Tensor& rows, const torch::Tensor& keys, std::int64_t n) {
  const torch::Tensor order = std::get<1>(torch::sort(keys, /*stable=*/true, /*dim=*/0, /*descending=*/true));
  return rows.index_select(0, order.slice(0, 0, n));
}

/// Returns an uninitialised tensor. @throws OutOfMemoryError
using AllocateTensor = std::function<torch::Tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options)>;
torch::Tensor allocate_tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options);

/// Applies edits to all tensors of a model, one after the other and in place. Beside the model, memory contains at most
/// the reallocated copy of one tensor, or the new rows of one tensor and one piece of its kept rows.
class RowEditor {
 public:
  /// Rows are moved in pieces of about `piece_elements` elements, which is enough to keep a GPU busy.
  explicit RowEditor(AllocateTensor allocate = allocate_tensor, std::int64_t piece_elements = 16 << 20)
      : allocate_(std::move(allocate)), piece_elements_(piece_elements) {}

  /// Allocates all memory that apply() needs. Tensors with less capacity than the rows of the edit are reallocated with
  /// capacity for n_room rows, which must be at least the rows of the edit. If this throws, the values of the model are
  /// unchanged. @throws OutOfMemoryError
  void reserve(const RowEdit& edit, std::int64_t n_room, GaussianTensors& gaussians, AdamState& adam,
               DensityStatistics& statistics);

  /// Applies the edit that reserve() was called with. Kept rows keep parameters, moments and statistics. New rows take
  /// the parameters and viewing directions of their sources, except for the means, scales and opacities in the edit,
  /// and their statistics and moments are 0. `gaussians.filters` becomes undefined. Allocates nothing.
  void apply(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

 private:
  /// Returns the number of rows that fit into a tensor's memory. Only tensors allocated by this editor may have spare
  /// capacity, because the memory behind other tensors may be in use.
  std::int64_t capacity(const torch::Tensor& tensor) const;

  AllocateTensor allocate_;
  std::int64_t piece_elements_;
  std::set<const void*> made_;  // data pointers of the tensors that reserve() allocated
  torch::Tensor scratch_;       // 1-D, of 4-byte elements
};

/// Calls reserve() and apply(), without spare capacity.
void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics);

// Removal of Gaussians that cannot be rendered, so that training can continue with the others.

/// Properties of the Gaussians that determine which of them are removed.
struct GaussianWidths {
  torch::Tensor is_finite;  // [N] bool, true if all parameters and Adam moments are finite
  torch::Tensor largest;    // [N] largest log scale
};
GaussianWidths gaussian_widths(const GaussianTensors& gaussians, const AdamState& adam);

/// Returns the edit that remove_invalid_gaussians() applies.
RowEdit edit_without_invalid(std::int64_t named, double extent, const GaussianWidths& widths);

/// Removes row `named` and all rows in which a parameter or an Adam moment is not finite. If the largest scale of the
/// named row exceeds 1e4 times the scene `extent` (world units), all rows with at least this scale are removed too.
/// Returns the number of removed rows.
std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics);

}  // namespace b3dgs
