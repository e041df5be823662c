#include "train/ranks/part_exchange.h"

#include <torch/types.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/splat_rows.h"
#include "raster/torch/splat_owner.h"
#include "raster/torch/tensor_arrays.h"
#include "train/ranks/splats/splat_words.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_launch.h"
#include "train/ranks/splats/splat_words_cuda.h"
#endif

namespace b3dgs {
namespace {

constexpr std::int64_t kSums = sizeof(SplatGradSum) / sizeof(float);
constexpr std::int64_t kScores = sizeof(ScoreSums) / sizeof(std::int32_t);

/// The splats that touch each band, one band after the other, and where the list of each ends.
/// Waits for the device once, unlike nonzero() and a sum.
/// @param touches  [bands, M] bool
std::pair<torch::Tensor, std::vector<std::int64_t>> list_touches(const torch::Tensor& touches) {
  const std::int64_t n_bands = touches.size(0), n_splats = touches.size(1);
  const auto integers = touches.options().dtype(torch::kInt64);
  if (n_splats == 0) return {torch::empty({0}, integers), std::vector<std::int64_t>(static_cast<std::size_t>(n_bands))};
  const torch::Tensor up_to = touches.flatten().cumsum(0);  // how many touch, up to this one
  const torch::Tensor on_host = up_to.view({n_bands, n_splats}).select(1, n_splats - 1).cpu().contiguous();
  const std::vector<std::int64_t> ends(on_host.data_ptr<std::int64_t>(), on_host.data_ptr<std::int64_t>() + n_bands);
  const torch::Tensor splats = torch::arange(n_splats, integers).expand({n_bands, n_splats}).reshape({-1});
  // Those that do not touch go to one place behind the list.
  const torch::Tensor slots = torch::where(touches.flatten(), up_to - 1, ends.back());
  const torch::Tensor places = torch::empty({ends.back() + 1}, integers).scatter_(0, slots, splats);
  return {places.slice(0, 0, ends.back()), ends};
}

/// Parts of the step that this rank draws.
std::vector<std::size_t> parts_of(const StepPlan& plan, int rank) {
  std::vector<std::size_t> parts;
  for (std::size_t p = 0; p < plan.size(); ++p) {
    if (plan[p].rank == rank) parts.push_back(p);
  }
  return parts;
}

}  // namespace

torch::Tensor touches_bands(const ViewSplats& splats, const std::vector<TileRowSpan>& bands, std::int32_t tile_height) {
  TensorCheck check(splats.splats.device());
  const SplatRows rows = rows_of(splats, check);
  const auto n_bands = static_cast<std::int64_t>(bands.size());
  const torch::Tensor touches = torch::empty({n_bands, rows.n_splats}, splats.radii.options().dtype(torch::kBool));
  for (std::int64_t first = 0; first < n_bands; first += TouchBandsArgs::kMaxBands) {
    TouchBandsArgs args{rows.n_splats, rows.splats, rows.extents, rows.radii};
    args.n_bands = static_cast<int>(std::min<std::int64_t>(TouchBandsArgs::kMaxBands, n_bands - first));
    for (int band = 0; band < args.n_bands; ++band) {
      const TileRowSpan& span = bands[static_cast<std::size_t>(first + band)];
      args.top[band] = static_cast<double>(span.begin) * tile_height;
      args.bottom[band] = static_cast<double>(span.end) * tile_height;
    }
    args.touches = touches.data_ptr<bool>() + first * rows.n_splats;
#if B3DGS_TORCH_CUDA
    if (touches.is_cuda()) {
      cuda::find_touched_bands(args, torch_launch_context().stream);
      continue;
    }
#endif
    constexpr std::int64_t kGrain = 4096;
    parallel_chunks(rows.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t m = begin; m < end; ++m) find_touched_bands(args, m);
    });
  }
  return touches;
}

std::vector<std::int64_t> PartExchange::begin(const StepPlan& plan, const std::vector<ViewSplats>& views,
                                              std::int32_t tile_height, const torch::Tensor& model_rows) {
  plan_ = plan;
  tile_height_ = tile_height;
  is_banded_ = b3dgs::is_banded(plan);
  n_own_.clear();
  places_.clear();
  std::vector<SentSplats> sent;
  std::vector<std::int64_t> counts;
  for (const ViewSplats& view : views) n_own_.push_back(view.size());
  if (!is_banded_) {
    for (const DrawnPart& part : plan_) {
      sent.push_back({views.at(part.view), {}});
      counts.push_back(sent.back().size());
    }
    splats_.pack(sent, drawers_of(plan_), model_rows);
    return counts;
  }
  for (std::size_t p = 0; p < plan_.size();) {  // the parts of a view together
    const ViewSplats& view = views.at(plan_[p].view);
    const torch::Tensor touches = touches_bands(view, bands_of(plan_[p].view), tile_height);
    const auto [places, ends] = list_touches(touches);
    std::int64_t begin = 0;
    for (const std::int64_t end : ends) {
      places_.push_back(places.slice(0, begin, end));
      sent.push_back({view, places_.back()});
      counts.push_back(end - begin);
      begin = end;
      ++p;
    }
  }
  splats_.pack(sent, drawers_of(plan_), model_rows);
  return counts;
}

std::vector<ViewSplats> PartExchange::to_drawers(const std::vector<std::vector<std::int64_t>>& counts) {
  drawn_ = splats_.to_drawers(counts);
  return drawn_;
}

std::vector<TileRowSpan> PartExchange::bands_of(std::size_t view) const {
  std::vector<TileRowSpan> bands;
  for (const DrawnPart& part : plan_) {
    if (part.view == view) bands.push_back(part.rows);
  }
  return bands;
}

torch::Tensor PartExchange::crossing(std::size_t i) const {
  const std::size_t view = plan_[parts_of(plan_, ranks_.rank()).at(i)].view;
  return (touches_bands(drawn_.at(i), bands_of(view), tile_height_).sum(0) > 1).nonzero().flatten();
}

void PartExchange::share_rows(const std::vector<torch::Tensor>& images, std::int64_t n_columns) {
  if (!is_banded_) return;
  const std::vector<std::size_t> parts = parts_of(plan_, ranks_.rank());
  B3DGS_CHECK(parts.size() <= 1 && parts.empty() == images.empty(), "a rank draws at most one band");
  const auto size = static_cast<std::size_t>(ranks_.size());
  std::vector<std::int64_t> send(size), receive(size);
  torch::Tensor sent = torch::empty({0, n_columns}, torch::dtype(torch::kFloat32).device(splats_.device()));
  const auto pixel_rows = [&](const DrawnPart& part) {
    const std::int64_t height = images[0].size(0);
    return std::pair(std::min<std::int64_t>(std::int64_t{part.rows.begin} * tile_height_, height),
                     std::min<std::int64_t>(std::int64_t{part.rows.end} * tile_height_, height));
  };
  if (!parts.empty()) {
    const DrawnPart& own = plan_[parts[0]];
    const std::int64_t width = images[0].size(1);
    const auto [begin, end] = pixel_rows(own);
    std::vector<torch::Tensor> columns;
    for (const torch::Tensor& image : images) {
      columns.push_back(
          image.slice(0, begin, end).reshape({(end - begin) * width, image.dim() == 3 ? image.size(2) : 1}));
    }
    const torch::Tensor rows = torch::cat(columns, 1);
    std::int64_t n_peers = 0;
    for (const DrawnPart& other : plan_) {
      if (other.view != own.view || other.rank == own.rank) continue;
      const auto [other_begin, other_end] = pixel_rows(other);
      send[static_cast<std::size_t>(other.rank)] = rows.size(0);
      receive[static_cast<std::size_t>(other.rank)] = (other_end - other_begin) * width;
      ++n_peers;
    }
    sent = rows.repeat({n_peers, 1});
  }
  const auto sum = [](const std::vector<std::int64_t>& counts) {
    return std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
  };
  const std::int64_t row_bytes = n_columns * static_cast<std::int64_t>(sizeof(float));
  sent_bytes_ += sum(send) * row_bytes;
  received_bytes_ += sum(receive) * row_bytes;
  const torch::Tensor received = ranks_.all_to_all_rows(sent, send, receive);
  std::int64_t n_read = 0;
  for (const DrawnPart& other : plan_) {  // by rank, as the parts of a view are
    const std::int64_t n = receive[static_cast<std::size_t>(other.rank)];
    if (n == 0) continue;
    const torch::Tensor rows = received.slice(0, n_read, n_read + n);
    n_read += n;
    const auto [begin, end] = pixel_rows(other);
    std::int64_t column = 0;
    for (const torch::Tensor& image : images) {
      const torch::Tensor to = image.slice(0, begin, end);
      const std::int64_t n_values = image.dim() == 3 ? image.size(2) : 1;
      to.copy_(rows.slice(1, column, column + n_values).reshape(to.sizes()));
      column += n_values;
    }
  }
}

std::vector<torch::Tensor> PartExchange::sums_to_owners(const std::vector<torch::Tensor>& sums,
                                                        const std::vector<SplatPairs>& pairs, bool is_exact) {
  const std::vector<torch::Tensor> by_part = splats_.to_owners(sums, kSums, torch::kFloat32);
  drawn_.clear();  // nobody asks what crosses any more
  if (!is_banded_) return by_part;
  std::vector<torch::Tensor> views;
  for (const std::int64_t n : n_own_) {
    views.push_back(torch::zeros({n, kSums}, torch::dtype(torch::kFloat32).device(splats_.device())));
  }
  for (std::size_t p = 0; p < plan_.size(); ++p) views[plan_[p].view].index_add_(0, places_[p], by_part[p]);
  if (!is_exact) return views;

  const std::vector<SplatPairs> own_pairs = splats_.pairs_to_owners(pairs, kSums);
  for (std::size_t v = 0; v < views.size(); ++v) {
    std::vector<torch::Tensor> splat_of_pair, rows;  // by band, from top to bottom
    for (std::size_t p = 0; p < plan_.size(); ++p) {
      if (plan_[p].view != v) continue;
      splat_of_pair.push_back(places_[p].repeat_interleave(own_pairs[p].counts));
      rows.push_back(own_pairs[p].sums);
    }
    const torch::Tensor splats = torch::cat(splat_of_pair);
    const torch::Tensor order = std::get<1>(torch::sort(splats, /*stable=*/true, /*dim=*/0, /*descending=*/false));
    const torch::Tensor counts = torch::bincount(splats, /*weights=*/{}, n_own_[v]);
    const torch::Tensor crossing = counts.nonzero().flatten();
    views[v].index_copy_(0, crossing,
                         sum_splat_pairs({counts.index_select(0, crossing), torch::cat(rows).index_select(0, order)}));
  }
  return views;
}

std::vector<torch::Tensor> PartExchange::scores_to_owners(const std::vector<torch::Tensor>& scores) {
  const std::vector<torch::Tensor> by_part = splats_.to_owners(scores, kScores, torch::kInt32);
  if (!is_banded_) return by_part;
  // As 64-bit integers: sums of errors and of weights, and the bits of the largest weight, which is not negative.
  std::vector<torch::Tensor> views;
  for (const std::int64_t n : n_own_) {
    views.push_back(torch::zeros({n, kScores / 2}, torch::dtype(torch::kInt64).device(splats_.device())));
  }
  for (std::size_t p = 0; p < plan_.size(); ++p) {
    torch::Tensor& view = views[plan_[p].view];
    const torch::Tensor part = by_part[p].view(torch::kInt64), before = view.index_select(0, places_[p]);
    const torch::Tensor after = torch::cat(
        {before.slice(1, 0, 2) + part.slice(1, 0, 2), torch::maximum(before.slice(1, 2, 3), part.slice(1, 2, 3))}, 1);
    view.index_copy_(0, places_[p], after);
  }
  for (torch::Tensor& view : views) view = view.view(torch::kInt32);
  return views;
}

std::vector<torch::Tensor> PartExchange::columns_to_drawers(const std::vector<torch::Tensor>& own,
                                                            std::int64_t n_columns, torch::ScalarType type) {
  B3DGS_CHECK(!is_banded_, "columns for the drawers of bands");
  return splats_.columns_to_drawers(own, n_columns, type);
}

}  // namespace b3dgs
