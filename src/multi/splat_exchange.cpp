#include "multi/splat_exchange.h"

#include <torch/types.h>

#include <numeric>
#include <utility>

#include "core/check.h"

namespace b3dgs {
namespace {

std::int64_t sum_of(const std::vector<std::int64_t>& counts) {
  return std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
}

void check_splats(const ViewSplats& splats, std::size_t view, const torch::Device& device) {
  const std::int64_t n = splats.splats.defined() ? splats.splats.size(0) : 0;
  const auto fits = [&](const torch::Tensor& tensor, torch::IntArrayRef sizes, torch::ScalarType type) {
    return tensor.defined() && tensor.sizes() == sizes && tensor.scalar_type() == type && tensor.is_contiguous() &&
           tensor.device() == device;
  };
  B3DGS_CHECK(fits(splats.splats, {n, kSplatWords}, torch::kFloat32) && fits(splats.extents, {n, 2}, torch::kFloat32) &&
                  fits(splats.radii, {n}, torch::kInt32),
              "splats of view ", view, " of the step: expected ", n, " rows in each tensor, contiguous on ",
              device.str());
}

}  // namespace

SplatExchange::SplatExchange(Communicator& ranks) : ranks_(ranks) {}

void SplatExchange::pack(const std::vector<ViewSplats>& own, const std::vector<int>& renderers,
                         const torch::Tensor& model_rows) {
  const auto size = static_cast<std::size_t>(ranks_.size());
  const std::size_t n_views = own.size();
  B3DGS_CHECK(renderers.size() == n_views, "renderers of ", renderers.size(), " views of ", n_views);
  own_counts_.clear();
  views_of_.assign(size, {});
  for (std::size_t v = 0; v < n_views; ++v) {
    B3DGS_CHECK(renderers[v] >= 0 && renderers[v] < ranks_.size(), "view ", v, " is rendered by rank ", renderers[v],
                " of ", size);
    views_of_[static_cast<std::size_t>(renderers[v])].push_back(v);
    own_counts_.push_back(own[v].size());
  }
  own_.clear();
  send_.assign(size, 0);
  if (n_views == 0) return;
  B3DGS_CHECK(own[0].splats.defined(), "splats of view 0 of the step are undefined");
  device_ = own[0].splats.device();
  for (std::size_t v = 0; v < n_views; ++v) check_splats(own[v], v, device_);
  if (size == 1) {
    own_ = own;
    return;
  }
  packed_ = torch::empty({sum_of(own_counts_), kRowWords}, torch::dtype(torch::kInt32).device(device_));
  std::int64_t n_packed = 0;
  for (std::size_t renderer = 0; renderer < size; ++renderer) {
    for (const std::size_t v : views_of_[renderer]) {
      pack_splats(own[v], model_rows, packed_.slice(0, n_packed, n_packed + own_counts_[v]));
      n_packed += own_counts_[v];
      send_[renderer] += own_counts_[v];
    }
  }
}

std::vector<ViewSplats> SplatExchange::to_renderers(const std::vector<std::vector<std::int64_t>>& counts) {
  const auto size = static_cast<std::size_t>(ranks_.size()), rank = static_cast<std::size_t>(ranks_.rank());
  const std::size_t n_views = own_counts_.size();
  B3DGS_CHECK(counts.size() == size, "numbers of splats from ", counts.size(), " ranks of ", size);
  for (const std::vector<std::int64_t>& of_rank : counts) {
    B3DGS_CHECK(of_rank.size() == n_views, "numbers of splats of ", of_rank.size(), " views of ", n_views);
  }
  for (std::size_t v = 0; v < n_views; ++v) {
    B3DGS_CHECK(counts[rank][v] == own_counts_[v], "splats of view ", v, " of the step: expected ", counts[rank][v],
                " rows, found ", own_counts_[v]);
  }
  received_.clear();
  if (n_views == 0) return {};
  if (size == 1) {
    for (const std::int64_t n : own_counts_) received_.push_back({n, {}});
    return std::exchange(own_, {});
  }
  receive_.assign(size, 0);
  for (std::size_t r = 0; r < size; ++r) {
    for (const std::size_t v : views_of_[rank]) receive_[r] += counts[r][v];
  }
  const torch::Tensor received = ranks_.all_to_all_rows(std::exchange(packed_, {}), send_, receive_);

  // Rows come by rank, those of a rank by view.
  std::vector<std::int64_t> next(size, 0);  // place of the next row of each rank
  std::exclusive_scan(receive_.begin(), receive_.end(), next.begin(), std::int64_t{0});
  std::vector<ViewSplats> rendered;
  for (const std::size_t v : views_of_[rank]) {
    std::vector<RowRange> lists;
    for (std::size_t r = 0; r < size; ++r) {
      const std::int64_t begin = std::exchange(next[r], next[r] + counts[r][v]);
      lists.push_back({begin, next[r]});
    }
    MergedSplats merged = merge_splats(received, lists);
    received_.push_back({merged.splats.size(), merged.places});
    rendered.push_back(std::move(merged.splats));
  }
  return rendered;
}

std::vector<torch::Tensor> SplatExchange::to_owners(const std::vector<torch::Tensor>& rendered, std::int64_t n_columns,
                                                    torch::ScalarType type) {
  B3DGS_CHECK(rendered.size() == received_.size(), rendered.size(), " tensors, but this rank renders ",
              received_.size(), " views of the step");
  for (std::size_t i = 0; i < rendered.size(); ++i) {
    const torch::Tensor& rows = rendered[i];
    B3DGS_CHECK(rows.defined() && rows.sizes() == torch::IntArrayRef({received_[i].n_splats, n_columns}) &&
                    rows.scalar_type() == type && rows.device() == device_,
                "tensor ", i, " for the owners of splats: expected [", received_[i].n_splats, ", ", n_columns, "] ",
                type, " on ", device_.str());
  }
  if (own_counts_.empty()) return {};
  if (ranks_.size() == 1) return rendered;

  torch::Tensor sent = torch::empty({sum_of(receive_), n_columns}, torch::dtype(type).device(device_));
  for (std::size_t i = 0; i < rendered.size(); ++i) sent.index_copy_(0, received_[i].places, rendered[i]);
  const torch::Tensor received = ranks_.all_to_all_rows(sent, receive_, send_);

  // Rows come by renderer, those of a renderer by view.
  const auto size = static_cast<std::size_t>(ranks_.size());
  std::vector<torch::Tensor> own(own_counts_.size());
  std::int64_t n_read = 0;
  for (std::size_t renderer = 0; renderer < size; ++renderer) {
    for (const std::size_t v : views_of_[renderer]) {
      own[v] = received.slice(0, n_read, n_read + own_counts_[v]);
      n_read += own_counts_[v];
    }
  }
  return own;
}

std::vector<torch::Tensor> SplatExchange::columns_to_renderers(const std::vector<torch::Tensor>& own,
                                                               std::int64_t n_columns, torch::ScalarType type) {
  B3DGS_CHECK(own.size() == own_counts_.size(), own.size(), " tensors for ", own_counts_.size(), " views");
  for (std::size_t v = 0; v < own.size(); ++v) {
    const torch::Tensor& rows = own[v];
    B3DGS_CHECK(rows.defined() && rows.sizes() == torch::IntArrayRef({own_counts_[v], n_columns}) &&
                    rows.scalar_type() == type && rows.device() == device_,
                "tensor ", v, " for the renderers of views: expected [", own_counts_[v], ", ", n_columns, "] ", type,
                " on ", device_.str());
  }
  if (own.empty()) return {};
  if (ranks_.size() == 1) return own;
  const auto size = static_cast<std::size_t>(ranks_.size());
  std::vector<torch::Tensor> parts;
  for (std::size_t renderer = 0; renderer < size; ++renderer) {
    for (const std::size_t v : views_of_[renderer]) parts.push_back(own[v]);
  }
  const torch::Tensor received = ranks_.all_to_all_rows(torch::cat(parts), send_, receive_);
  std::vector<torch::Tensor> rendered;
  for (const ReceivedView& view : received_) rendered.push_back(received.index_select(0, view.places));
  return rendered;
}

}  // namespace b3dgs
