#include "multi/splat_exchange.h"

#include <torch/types.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {
namespace {

const std::int32_t* words_of(const torch::Tensor& rows) {
  return static_cast<const std::int32_t*>(rows.data_ptr());
}

torch::Tensor rows_of(const torch::Tensor& tensor, const RowRange& rows) {
  return tensor.slice(0, rows.begin, rows.end);
}

}  // namespace

void pack_splats(const ViewSplats& splats, const torch::Tensor& model_rows, const torch::Tensor& words) {
  const PackSplatsArgs args{splats.size(),          words_of(splats.splats), words_of(splats.extents),
                            words_of(splats.radii), words_of(model_rows),    words.data_ptr<std::int32_t>()};
  for_rows<pack_splat_word>(words.is_cuda(), args, args.n_splats * kRowWords);
}

MergedSplats merge_splats(const torch::Tensor& words, const std::vector<RowRange>& lists) {
  B3DGS_CHECK(lists.size() <= MergeSplatsArgs::kMaxLists, lists.size(), " ranks");
  MergeSplatsArgs args;
  std::int64_t n = 0;
  for (const auto& [begin, end] : lists) {
    args.begin[args.n_lists] = begin;
    args.end[args.n_lists++] = end;
    n += end - begin;
  }
  const torch::TensorOptions floats = words.options().dtype(torch::kFloat32);
  MergedSplats merged{
      {torch::empty({n, kSplatWords}, floats), torch::empty({n, 2}, floats), torch::empty({n}, words.options())},
      torch::empty({n}, words.options().dtype(torch::kInt64))};
  args.words = words.data_ptr<std::int32_t>();
  args.splats = static_cast<std::int32_t*>(merged.splats.splats.data_ptr());
  args.extents = static_cast<std::int32_t*>(merged.splats.extents.data_ptr());
  args.radii = merged.splats.radii.data_ptr<std::int32_t>();
  args.places = merged.places.data_ptr<std::int64_t>();
  if (kTorchHasCuda && words.is_cuda()) {
    cuda::merge_splats(args, n, torch_stream());
    return merged;
  }
  parallel_each(n, /*grain=*/4096, [&](std::int64_t i) {
    const MergedPlace at = merged_place(args, i);
    for (std::int64_t column = 0; column < kRowWords; ++column) merge_word(args, at, column);
  });
  return merged;
}

void SplatExchange::pack(const std::vector<ViewSplats>& own, const std::vector<int>& renderers,
                         const torch::Tensor& model_rows) {
  renderers_ = renderers;
  order_.resize(own.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  std::stable_sort(order_.begin(), order_.end(),
                   [&](std::size_t a, std::size_t b) { return renderers[a] < renderers[b]; });
  send_.assign(static_cast<std::size_t>(ranks_.size()), 0);
  std::int64_t n = 0;
  own_rows_.resize(own.size());
  for (const std::size_t v : order_) {
    own_rows_[v] = {n, n + own[v].size()};
    n = own_rows_[v].end;
    send_[static_cast<std::size_t>(renderers[v])] += own[v].size();
  }
  packed_ = torch::empty({n, kRowWords}, model_rows.options());
  for (std::size_t v = 0; v < own.size(); ++v) pack_splats(own[v], model_rows, rows_of(packed_, own_rows_[v]));
}

std::vector<ViewSplats> SplatExchange::to_renderers(const std::vector<std::vector<std::int64_t>>& counts) {
  // Received rows are ordered by rank, and those of a rank by view.
  std::vector<std::vector<RowRange>> lists;  // for each view that this rank renders, rows by rank
  receive_.assign(counts.size(), 0);
  std::int64_t n = 0;
  for (std::size_t r = 0; r < counts.size(); ++r) {
    std::size_t i = 0;
    for (std::size_t v = 0; v < renderers_.size(); ++v) {
      if (renderers_[v] != ranks_.rank()) continue;
      if (i == lists.size()) lists.emplace_back();
      lists[i++].push_back({n, n + counts[r][v]});
      n += counts[r][v];
      receive_[r] += counts[r][v];
    }
  }
  const torch::Tensor received = ranks_.all_to_all_rows(std::exchange(packed_, {}), send_, receive_);
  std::vector<ViewSplats> rendered;
  places_.clear();
  for (const std::vector<RowRange>& of_view : lists) {
    MergedSplats merged = merge_splats(received, of_view);
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
  std::vector<torch::Tensor> own;
  for (const RowRange& rows : own_rows_) own.push_back(rows_of(received, rows));
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
