#include "multi/rows/row_owners.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "core/check.h"

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

}  // namespace b3dgs
