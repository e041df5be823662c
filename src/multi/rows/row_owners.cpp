#include "multi/rows/row_owners.h"

#include <torch/types.h>

#include <algorithm>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "multi/rows/sharded_rows.h"

namespace b3dgs {

RowOwners::RowOwners(int rank, int size, torch::Tensor owners)
    : rank_(rank), size_(size), n_rows_(owners.size(0)), owners_(std::move(owners)) {
  B3DGS_CHECK(rank >= 0 && rank < size && size <= std::numeric_limits<std::int16_t>::max(), "rank ", rank, " of ",
              size);
  B3DGS_CHECK(n_rows_ <= std::numeric_limits<std::int32_t>::max(), n_rows_, " rows");
  own_ = (owners_ == rank).nonzero().flatten().to(torch::kInt32);
  std::vector<torch::Tensor> counts;
  for (int r = 0; r < size; ++r) counts.push_back((owners_ == r).sum());
  const torch::Tensor on_host = torch::stack(counts).cpu();
  const auto* const values = on_host.data_ptr<std::int64_t>();
  n_of_ranks_.assign(values, values + size);
}

RowOwners RowOwners::round_robin(int rank, int size, std::int64_t n_rows, torch::Device device) {
  if (size == 1) {
    RowOwners all;
    all.n_rows_ = all.n_of_ranks_[0] = n_rows;
    return all;
  }
  const torch::Tensor rows = torch::arange(n_rows, torch::dtype(torch::kInt64).device(device));
  return {rank, size, torch::div(rows, kBlock, "floor").remainder(size).to(torch::kInt16)};
}

std::int64_t RowOwners::n_most() const {
  return *std::max_element(n_of_ranks_.begin(), n_of_ranks_.end());
}

bool RowOwners::are_uneven() const {
  constexpr double kUneven = 1.05;
  const std::int64_t n_blocks = (n_rows_ + kBlock - 1) / kBlock;
  const std::int64_t n_even = std::min(n_rows_, (n_blocks + size_ - 1) / size_ * kBlock);  // of rank 0, if round-robin
  return static_cast<double>(n_most()) > kUneven * static_cast<double>(n_even);
}

std::int64_t RowOwners::row_of_model(std::int64_t own_row) const {
  return size_ == 1 ? own_row : own_[own_row].item<std::int32_t>();
}

torch::Tensor RowOwners::own_rows_of(const torch::Tensor& model_rows) const {
  return size_ == 1 ? model_rows.to(torch::kInt64) : torch::searchsorted(own_, model_rows.to(torch::kInt32));
}

RowOwners RowOwners::after(const torch::Tensor& sources) const {
  if (size_ == 1) return round_robin(0, 1, sources.size(0), sources.device());
  return {rank_, size_, owners_.index_select(0, sources)};
}

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
