#include "multi/rows/sharded_row_edit.h"

#include <torch/types.h>

#include <string>
#include <vector>

#include "core/check.h"
#include "multi/rows/sharded_rows.h"

namespace b3dgs {
namespace {

/// Why the edit does not fit this rank's tensors; "" if it does.
std::string find_misfit(const RowEdit& edit, const SourceNumbers& numbers, const RowOwners& owners,
                        const std::vector<torch::Tensor*>& tensors) {
  const std::int64_t n_before = owners.n_rows(), n_own = owners.n_own();
  const std::int64_t n_new = edit.sources.size(0) - edit.n_kept;
  for (const torch::Tensor* tensor : tensors) {
    if (!tensor->defined() || tensor->size(0) != n_own || !tensor->is_contiguous()) {
      return detail::concat("a tensor has ", tensor->defined() ? tensor->size(0) : 0, " rows of ", n_before,
                            " Gaussians, expected ", n_own, ", contiguous");
    }
  }
  const bool has_opacities = edit.new_logit_opacities.defined();
  if (n_new < 0 || edit.n_kept < 0 || edit.new_means.size(0) != n_new || edit.new_log_scales.size(0) != n_new ||
      (has_opacities && edit.new_logit_opacities.size(0) != n_new)) {
    return detail::concat("the edit keeps ", edit.n_kept, " of ", edit.sources.size(0), " rows, but has ",
                          edit.new_means.size(0), " new means");
  }
  if (edit.sources.numel() > 0 && (numbers.first < 0 || numbers.last >= n_before)) {
    return detail::concat("sources of the edit are from ", numbers.first, " to ", numbers.last, ", but there are ",
                          n_before, " Gaussians");
  }
  return "";
}

/// Numbers that decide what ranks do; those of different edits are different, but for rare cases.
std::vector<std::int64_t> identify(const RowEdit& edit, const SourceNumbers& numbers, const RowOwners& owners,
                                   const GaussianTensors& gaussians, const DensityStatistics& statistics) {
  return {owners.n_rows(),
          edit.sources.size(0),
          edit.n_kept,
          numbers.weighted_sum,
          static_cast<std::int64_t>(edit.new_logit_opacities.defined()),
          gaussians.shN.size(1),
          static_cast<std::int64_t>(statistics.extra.size())};
}

}  // namespace

SourceNumbers source_numbers(const RowEdit& edit) {
  const torch::Tensor& sources = edit.sources;
  if (sources.numel() == 0) return {};
  const torch::Tensor weights = torch::arange(1, sources.size(0) + 1, sources.options());
  const torch::Tensor numbers = torch::stack({sources.min(), sources.max(), (sources * weights).sum()}).cpu();
  const auto* const values = numbers.data_ptr<std::int64_t>();
  return {values[0], values[1], values[2]};
}

void check_row_edit(Communicator& ranks, const RowEdit& edit, const SourceNumbers& numbers, const RowOwners& owners,
                    GaussianTensors& gaussians, AdamState& adam, DensityStatistics& statistics) {
  std::vector<torch::Tensor*> tensors = statistics.all();
  for (GaussianTensors* of : {&gaussians, &adam.m, &adam.v}) {
    for (torch::Tensor* tensor : of->all()) tensors.push_back(tensor);
  }
  check_together(ranks, "row edit", identify(edit, numbers, owners, gaussians, statistics),
                 find_misfit(edit, numbers, owners, tensors));
}

OwnRowEdit own_part(const RowEdit& edit, const RowOwners& owners) {
  OwnRowEdit part{owners.after(edit.sources), edit};
  if (owners.size() == 1) return part;
  const torch::Tensor& rows = part.owners.own();  // of the model after the edit
  RowEdit& own = part.edit;
  own.sources = owners.own_rows_of(edit.sources.index_select(0, rows));
  own.n_kept = (rows < edit.n_kept).sum().item<std::int64_t>();
  const torch::Tensor own_new = rows.slice(0, own.n_kept) - edit.n_kept;
  own.new_means = edit.new_means.index_select(0, own_new);
  own.new_log_scales = edit.new_log_scales.index_select(0, own_new);
  if (edit.new_logit_opacities.defined()) own.new_logit_opacities = edit.new_logit_opacities.index_select(0, own_new);
  return part;
}

RowOwners apply_row_edit(Communicator& ranks, const RowEdit& edit, const RowOwners& owners, GaussianTensors& gaussians,
                         AdamState& adam, DensityStatistics& statistics) {
  check_row_edit(ranks, edit, source_numbers(edit), owners, gaussians, adam, statistics);
  const OwnRowEdit own = own_part(edit, owners);
  apply_row_edit(own.edit, gaussians, adam, statistics);
  return own.owners;
}

}  // namespace b3dgs
