#include "multi/rows/row_owners.h"

#include <torch/types.h>

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "core/check.h"

namespace b3dgs {

RowOwners::RowOwners(int rank, int size, torch::Tensor owners)
    : rank_(rank), size_(size), n_rows_(owners.size(0)), owners_(std::move(owners)) {
  B3DGS_CHECK(rank >= 0 && rank < size && size <= std::numeric_limits<std::int16_t>::max(), "rank ", rank, " of ",
              size);
  B3DGS_CHECK(n_rows_ <= std::numeric_limits<std::int32_t>::max(), n_rows_, " rows");
  own_ = (owners_ == rank).nonzero().flatten().to(torch::kInt32);
  n_of_ranks_ = count(0, n_rows_);
}

RowOwners RowOwners::round_robin(int rank, int size, std::int64_t n_rows, torch::Device device) {
  const torch::Tensor rows = torch::arange(n_rows, torch::dtype(torch::kInt64).device(device));
  return {rank, size, torch::div(rows, kBlock, "floor").remainder(size).to(torch::kInt16)};
}

std::vector<std::int64_t> RowOwners::count(std::int64_t begin, std::int64_t end) const {
  const torch::Tensor counts = torch::bincount(owners_.slice(0, begin, end), {}, size_).cpu();
  const auto* const values = counts.data_ptr<std::int64_t>();
  return {values, values + size_};
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
  return own_[own_row].item<std::int32_t>();
}

torch::Tensor RowOwners::own_rows_of(const torch::Tensor& model_rows) const {
  return torch::searchsorted(own_, model_rows.to(torch::kInt32));
}

RowOwners RowOwners::after(const torch::Tensor& sources) const {
  return {rank_, size_, owners_.index_select(0, sources)};
}

OwnRowEdit own_part(const RowEdit& edit, const RowOwners& owners) {
  OwnRowEdit part{owners.after(edit.sources), edit};
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

}  // namespace b3dgs
