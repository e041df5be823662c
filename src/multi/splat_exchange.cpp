#include "multi/splat_exchange.h"

#include <torch/types.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/check.h"

namespace b3dgs {

void SplatExchange::pack(const std::vector<ViewSplats>& own, const std::vector<int>& renderers,
                         const torch::Tensor& model_rows) {
  renderers_ = renderers;
  order_.resize(own.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  std::stable_sort(order_.begin(), order_.end(),
                   [&](std::size_t a, std::size_t b) { return renderers[a] < renderers[b]; });
  own_counts_.clear();
  for (const ViewSplats& splats : own) own_counts_.push_back(splats.size());
  send_.assign(static_cast<std::size_t>(ranks_.size()), 0);
  const std::int64_t n_all = std::accumulate(own_counts_.begin(), own_counts_.end(), std::int64_t{0});
  packed_ = torch::empty({n_all, kRowWords}, model_rows.options());
  std::int64_t n_packed = 0;
  for (const std::size_t v : order_) {
    pack_splats(own[v], model_rows, packed_.slice(0, n_packed, n_packed + own_counts_[v]));
    n_packed += own_counts_[v];
    send_[static_cast<std::size_t>(renderers[v])] += own_counts_[v];
  }
}

std::vector<ViewSplats> SplatExchange::to_renderers(const std::vector<std::vector<std::int64_t>>& counts) {
  std::vector<std::size_t> views;  // that this rank renders
  for (std::size_t v = 0; v < renderers_.size(); ++v) {
    if (renderers_[v] == ranks_.rank()) views.push_back(v);
  }
  receive_.assign(counts.size(), 0);
  for (std::size_t r = 0; r < counts.size(); ++r) {
    for (const std::size_t v : views) receive_[r] += counts[r][v];
  }
  const torch::Tensor received = ranks_.all_to_all_rows(std::exchange(packed_, {}), send_, receive_);

  // Rows come by rank, those of a rank by view.
  std::vector<std::int64_t> next(receive_.size(), 0);  // place of the next row of each rank
  std::exclusive_scan(receive_.begin(), receive_.end(), next.begin(), std::int64_t{0});
  std::vector<ViewSplats> rendered;
  places_.clear();
  for (const std::size_t v : views) {
    std::vector<RowRange> lists;
    for (std::size_t r = 0; r < counts.size(); ++r) {
      const std::int64_t begin = std::exchange(next[r], next[r] + counts[r][v]);
      lists.push_back({begin, next[r]});
    }
    MergedSplats merged = merge_splats(received, lists);
    places_.push_back(std::move(merged.places));
    rendered.push_back(std::move(merged.splats));
  }
  return rendered;
}

std::vector<torch::Tensor> SplatExchange::to_owners(const std::vector<torch::Tensor>& rendered, std::int64_t n_columns,
                                                    torch::ScalarType type) {
  B3DGS_CHECK(rendered.size() == places_.size(), rendered.size(), " tensors, but this rank renders ", places_.size(),
              " views of the step");
  const std::int64_t n_rendered = std::accumulate(receive_.begin(), receive_.end(), std::int64_t{0});
  torch::Tensor sent = torch::empty({n_rendered, n_columns}, torch::dtype(type).device(ranks_.device()));
  for (std::size_t i = 0; i < rendered.size(); ++i) sent.index_copy_(0, places_[i], rendered[i]);
  const torch::Tensor received = ranks_.all_to_all_rows(sent, receive_, send_);
  std::vector<torch::Tensor> own(own_counts_.size());
  std::int64_t n_read = 0;
  for (const std::size_t v : order_) {
    own[v] = received.slice(0, n_read, n_read + own_counts_[v]);
    n_read += own_counts_[v];
  }
  return own;
}

std::vector<torch::Tensor> SplatExchange::columns_to_renderers(const std::vector<torch::Tensor>& own) {
  std::vector<torch::Tensor> parts;
  for (const std::size_t v : order_) parts.push_back(own[v]);
  const torch::Tensor received = ranks_.all_to_all_rows(torch::cat(parts), send_, receive_);
  std::vector<torch::Tensor> rendered;
  for (const torch::Tensor& places : places_) rendered.push_back(received.index_select(0, places));
  return rendered;
}

}  // namespace b3dgs
