#include "train/density/row_edit.h"

#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {

DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device) {
  const auto counts = torch::TensorOptions(torch::kInt32).device(device);
  DensityStatistics statistics;
  statistics.grad_norm_sum = torch::zeros({n_gaussians}, counts.dtype(torch::kFloat32));
  statistics.view_count = torch::zeros({n_gaussians}, counts);
  statistics.max_radii = torch::zeros({n_gaussians}, counts);
  return statistics;
}

std::int64_t row_elements(const torch::Tensor& tensor) {
  return c10::multiply_integers(tensor.sizes().slice(1));
}

namespace {

std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& tensor, std::int64_t n_rows) {
  std::vector<std::int64_t> sizes = tensor.sizes().vec();
  sizes[0] = n_rows;
  return sizes;
}

/// Returns the number of rows that fit into the tensor's storage, counted from its first row.
std::int64_t stored_rows(const torch::Tensor& tensor) {
  const auto n = static_cast<std::int64_t>(tensor.storage().nbytes() / tensor.itemsize()) - tensor.storage_offset();
  return row_elements(tensor) > 0 ? n / row_elements(tensor) : std::numeric_limits<std::int64_t>::max();
}

/// Returns the first n_rows of that storage, regardless of the tensor's own size.
torch::Tensor with_rows(const torch::Tensor& tensor, std::int64_t n_rows) {
  B3DGS_CHECK(tensor.is_contiguous() && n_rows <= stored_rows(tensor), n_rows, " rows in storage for ",
              stored_rows(tensor));
  return tensor.as_strided(sizes_with_rows(tensor, n_rows), tensor.strides());
}

/// Returns the number of rows to move at a time.
std::int64_t piece_rows(const torch::Tensor& tensor, std::int64_t piece_elements) {
  return std::max<std::int64_t>(1, piece_elements / std::max<std::int64_t>(1, row_elements(tensor)));
}

/// Applies the edit to the tensor within its own storage, `piece` rows at a time.
void edit_tensor(const RowEdit& edit, std::int64_t piece, const torch::Tensor& scratch, torch::Tensor& tensor,
                 bool copies_new) {
  const std::int64_t n_rows = edit.sources.size(0), n_new = n_rows - edit.n_kept, per_row = row_elements(tensor);
  const torch::Tensor elements = scratch.view(tensor.scalar_type());
  // Copies the rows sources[begin, end) to the scratch memory, starting at its row `at`.
  const auto gather = [&](std::int64_t at, std::int64_t begin, std::int64_t end) {
    torch::Tensor rows =
        elements.slice(0, at * per_row, (at + end - begin) * per_row).view(sizes_with_rows(tensor, end - begin));
    torch::index_select_out(rows, tensor, 0, edit.sources.slice(0, begin, end));
    return rows;
  };
  torch::Tensor new_rows;
  if (copies_new) new_rows = gather(0, edit.n_kept, n_rows);
  torch::Tensor result = with_rows(tensor, n_rows);
  // Kept rows stay at their index or move to a lower one, so no piece overwrites rows that a later piece reads.
  for (std::int64_t begin = 0; begin < edit.n_kept; begin += piece) {
    const std::int64_t end = std::min(begin + piece, edit.n_kept);
    result.slice(0, begin, end).copy_(gather(n_new, begin, end));
  }
  torch::Tensor added = result.slice(0, edit.n_kept);
  copies_new ? added.copy_(new_rows) : added.zero_();
  tensor = result;
}

}  // namespace

torch::Tensor allocate_tensor(torch::IntArrayRef sizes, const torch::TensorOptions& options) {
  try {
    return torch::empty(sizes, options);
  } catch (const c10::OutOfMemoryError& error) {
    throw OutOfMemoryError(error.what_without_backtrace());
  }
}

std::int64_t RowEditor::capacity(const torch::Tensor& tensor) const {
  return made_.count(tensor.data_ptr()) > 0 ? stored_rows(tensor) : tensor.size(0);
}

void RowEditor::reserve(const RowEdit& edit, std::int64_t n_room, GaussianTensors& gaussians, AdamState& adam,
                        DensityStatistics& statistics) {
  const std::int64_t n_rows = edit.sources.size(0), n_new = n_rows - edit.n_kept;
  for (const torch::Tensor* added : {&edit.new_means, &edit.new_log_scales, &edit.new_logit_opacities}) {
    B3DGS_CHECK(!added->defined() || added->size(0) == n_new, "the edit keeps ", edit.n_kept, " of ", n_rows,
                " rows, but has ", added->size(0), " new values");
  }
  B3DGS_CHECK(n_room >= n_rows, "reserving ", n_room, " rows for an edit of ", n_rows);
  // The largest need of a tensor: its new rows, which are read before their sources move, and one piece.
  std::int64_t n_scratch = 0;
  visit_rows(gaussians, adam, statistics, [&](torch::Tensor& tensor) {
    const std::int64_t n_moved = std::min(edit.n_kept, piece_rows(tensor, piece_elements_));
    n_scratch = std::max(n_scratch, (n_new + n_moved) * row_elements(tensor));
    if (capacity(tensor) >= n_rows) return;
    const torch::Tensor larger = allocate_(sizes_with_rows(tensor, n_room), tensor.options());
    larger.slice(0, 0, tensor.size(0)).copy_(tensor);
    made_.erase(tensor.data_ptr());
    tensor = larger.slice(0, 0, tensor.size(0));
    if (row_elements(tensor) > 0) made_.insert(tensor.data_ptr());
  });
  scratch_ = allocate_({n_scratch}, gaussians.means.options());
}

void RowEditor::apply(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics) {
  B3DGS_CHECK(scratch_.defined(), "apply() without reserve()");
  const torch::Tensor scratch = std::exchange(scratch_, {});
  const auto edit_all = [&](auto& group, bool copies_new) {
    for (torch::Tensor* tensor : group.all())
      edit_tensor(edit, piece_rows(*tensor, piece_elements_), scratch, *tensor, copies_new);
  };
  edit_all(gaussians, true);
  edit_all(adam.m, false);
  edit_all(adam.v, false);
  if (torch::Tensor& directions = adam.directions; directions.defined()) {
    edit_tensor(edit, piece_rows(directions, piece_elements_), scratch, directions, true);
  }
  edit_all(statistics, false);
  gaussians.means.slice(0, edit.n_kept).copy_(edit.new_means);
  gaussians.log_scales.slice(0, edit.n_kept).copy_(edit.new_log_scales);
  if (edit.new_logit_opacities.defined()) {
    gaussians.logit_opacities.slice(0, edit.n_kept).copy_(edit.new_logit_opacities);
  }
  gaussians.filters = torch::Tensor();
}

void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics) {
  RowEditor editor;
  editor.reserve(edit, edit.sources.size(0), gaussians, adam, statistics);
  editor.apply(edit, gaussians, adam, statistics);
}

GaussianWidths gaussian_widths(const GaussianTensors& gaussians, const AdamState& adam) {
  GaussianWidths widths;
  widths.is_finite = torch::ones({gaussians.size()}, gaussians.means.options().dtype(torch::kBool));
  for (const GaussianTensors* group : {&gaussians, &adam.m, &adam.v}) {
    for (const torch::Tensor* tensor : group->all()) {
      widths.is_finite.logical_and_(torch::isfinite(tensor->reshape({gaussians.size(), row_elements(*tensor)})).all(1));
    }
  }
  widths.largest = gaussians.log_scales.amax(1);
  return widths;
}

RowEdit edit_without_invalid(std::int64_t named, double extent, const GaussianWidths& widths) {
  constexpr double kAbsurd = 1e4;  // times the scene extent
  const std::int64_t n = widths.largest.size(0);
  B3DGS_CHECK(named >= 0 && named < n, "Gaussian ", named, " of ", n);
  torch::Tensor stays = widths.is_finite.clone();
  stays.slice(0, named, named + 1).fill_(false);
  const double own = widths.largest[named].item<double>();
  if (std::isfinite(own) && own > std::log(kAbsurd * extent)) stays.logical_and_(widths.largest < own);
  return keep_rows(rows_of(stays), widths.largest.options());
}

std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics) {
  const std::int64_t n = gaussians.size();
  const RowEdit edit = edit_without_invalid(named, extent, gaussian_widths(gaussians, adam));
  apply_row_edit(edit, gaussians, adam, statistics);
  return n - edit.n_kept;
}

}  // namespace b3dgs
