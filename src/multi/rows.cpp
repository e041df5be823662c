#include "multi/rows.h"

#include <torch/types.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "core/check.h"

namespace b3dgs {
namespace {

/// Returns the number of rows of each rank. Waits for the device.
std::vector<std::int64_t> count(const torch::Tensor& owners, int size) {
  const torch::Tensor counts = torch::bincount(owners, {}, size).cpu();
  const auto* const values = counts.data_ptr<std::int64_t>();
  return {values, values + size};
}

/// Returns the order that sorts the rows by rank. Rows of one rank stay in order.
torch::Tensor order_by_rank(const torch::Tensor& owners) {
  return std::get<1>(torch::sort(owners, /*stable=*/true, /*dim=*/0, /*descending=*/false));
}

/// Gathers the rows in pieces. exchange(own rows of a piece, counts of all ranks) returns the rows of the piece in the
/// order of the ranks, which are written to `whole` if that is defined.
template <class Exchange>
void gather_pieces(const torch::Tensor& own, const RowOwners& owners, std::int64_t piece_bytes,
                   const torch::Tensor& whole, Exchange&& exchange) {
  B3DGS_CHECK(own.is_contiguous() && own.size(0) == owners.n_own(), "expected ", owners.n_own(), " contiguous rows of ",
              owners.n_rows());
  const std::int64_t row_bytes = row_elements(own) * static_cast<std::int64_t>(own.element_size());
  const std::int64_t n_of_piece =
      std::max<std::int64_t>(1, piece_bytes / std::max<std::int64_t>(1, row_bytes)) * owners.size();
  std::int64_t own_begin = 0, end = 0;
  for (std::int64_t begin = 0; begin < owners.n_rows(); begin = end) {
    end = std::min(begin + n_of_piece, owners.n_rows());
    const torch::Tensor of_piece = owners.owners().slice(0, begin, end);
    const std::vector<std::int64_t> counts = count(of_piece, owners.size());
    const std::int64_t own_end = own_begin + counts[static_cast<std::size_t>(owners.rank())];
    const torch::Tensor received = exchange(own.slice(0, std::exchange(own_begin, own_end), own_end), counts);
    if (!whole.defined()) continue;
    whole.slice(0, begin, end).index_copy_(0, order_by_rank(of_piece).to(whole.device()), received.to(whole.device()));
  }
}

}  // namespace

RowOwners::RowOwners(int rank, int size, torch::Tensor owners)
    : rank_(rank), size_(size), n_rows_(owners.size(0)), owners_(std::move(owners)) {
  B3DGS_CHECK(rank >= 0 && rank < size && size <= std::numeric_limits<std::int16_t>::max(), "rank ", rank, " of ",
              size);
  B3DGS_CHECK(n_rows_ <= std::numeric_limits<std::int32_t>::max(), n_rows_, " rows");
  own_ = (owners_ == rank).nonzero().flatten().to(torch::kInt32);
  n_own_ = own_.size(0);
}

RowOwners RowOwners::round_robin(int rank, int size, std::int64_t n_rows, torch::Device device) {
  const torch::Tensor rows = torch::arange(n_rows, torch::dtype(torch::kInt64).device(device));
  return {rank, size, torch::div(rows, kBlock, "floor").remainder(size).to(torch::kInt16)};
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
  const torch::Tensor& rows = part.owners.own();  // indices in the model after the edit
  RowEdit& own = part.edit;
  own.sources = owners.own_rows_of(edit.sources.index_select(0, rows));
  own.n_kept = (rows < edit.n_kept).sum().item<std::int64_t>();
  const torch::Tensor own_new = rows.slice(0, own.n_kept) - edit.n_kept;
  own.new_means = edit.new_means.index_select(0, own_new);
  own.new_log_scales = edit.new_log_scales.index_select(0, own_new);
  if (edit.new_logit_opacities.defined()) own.new_logit_opacities = edit.new_logit_opacities.index_select(0, own_new);
  return part;
}

torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners) {
  return whole.index_select(0, owners.own().to(whole.device()));
}

torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          std::int64_t piece_bytes) {
  const torch::Tensor whole = torch::empty(sizes_with_rows(own, owners.n_rows()), own.options());
  gather_pieces(own, owners, piece_bytes, whole,
                [&](const torch::Tensor& rows, const auto& counts) { return ranks.all_gather_rows(rows, counts); });
  return whole;
}

torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes) {
  torch::Tensor whole;
  if (ranks.is_first()) {
    whole = torch::empty(sizes_with_rows(own, owners.n_rows()), own.options().device(torch::kCPU));
  }
  gather_pieces(own, owners, piece_bytes, whole, [&](const torch::Tensor& rows, const auto& counts) {
    std::vector<std::int64_t> send(counts.size(), 0), receive = send;
    send[0] = rows.size(0);
    return ranks.all_to_all_rows(rows, send, ranks.is_first() ? counts : receive);
  });
  return whole;
}

}  // namespace b3dgs
