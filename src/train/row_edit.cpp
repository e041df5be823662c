#include "train/row_edit.h"

#include "check.h"

namespace b3dgs {
namespace {

/// Rows of `tensor` that are kept, followed by zeros for the new ones.
torch::Tensor keep_rows(const RowEdit& edit, const torch::Tensor& tensor) {
  std::vector<std::int64_t> sizes = tensor.sizes().vec();
  sizes[0] = edit.sources.size(0);
  torch::Tensor result = torch::zeros(sizes, tensor.options());
  torch::Tensor kept = result.slice(0, 0, edit.n_kept);
  torch::index_select_out(kept, tensor, 0, edit.sources.slice(0, 0, edit.n_kept));
  return result;
}

}  // namespace

void apply_row_edit(const RowEdit& edit, GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics) {
  const std::int64_t n_rows = edit.sources.size(0), n_new = n_rows - edit.n_kept;
  B3DGS_CHECK(n_new >= 0 && edit.new_means.size(0) == n_new && edit.new_log_scales.size(0) == n_new, "the edit keeps ",
              edit.n_kept, " of ", n_rows, " rows and brings ", edit.new_means.size(0), " means and ",
              edit.new_log_scales.size(0), " scales");
  for (torch::Tensor* parameter : gaussians.all()) *parameter = parameter->index_select(0, edit.sources);
  gaussians.means.slice(0, edit.n_kept).copy_(edit.new_means);
  gaussians.log_scales.slice(0, edit.n_kept).copy_(edit.new_log_scales);
  for (GaussianTensors* moments : {&adam.m, &adam.v}) {
    for (torch::Tensor* moment : moments->all()) *moment = keep_rows(edit, *moment);
  }
  for (torch::Tensor* statistic : statistics.all()) *statistic = keep_rows(edit, *statistic);
}

}  // namespace b3dgs
