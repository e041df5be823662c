// Scoring. Threads take tiles from an atomic counter; SIMD lanes are pixels; a tile's splats are visited front to back.
// The sums of a (tile, splat) pair are written once, to the pair's slot: no two threads write to the same place.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/score.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// After lanes-inl.h, whose SIMD type it computes on.
#include "raster/math/blend.h"

#include <algorithm>
#include <cstring>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// Pixels of one tile as planes. Rows are padded to whole vectors; padding is finished.
struct TileErrors {
  static constexpr int kCapacity = cpu::kMaxTileSide * cpu::kMaxTileSide;
  HWY_ALIGN float transmittance[kCapacity];  // as in PixelState
  HWY_ALIGN float error[kCapacity];
  Rect rect;
  int rows, row_vectors, stride;

  void begin(const ScoreArgs& args, std::int32_t tile) {
    rect = tile_pixels(args.grid, tile);
    rows = rect.y_end - rect.y_begin;
    row_vectors = (args.grid.tile.width + lane_count() - 1) / lane_count();
    stride = row_vectors * lane_count();
    std::fill(transmittance, transmittance + rows * stride, kClosedPixel);
    std::fill(error, error + rows * stride, 0.0f);
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < rect.x_end - rect.x_begin; ++column) {
        const std::int64_t pixel = std::int64_t{rect.y_begin + row} * args.grid.image_width + rect.x_begin + column;
        transmittance[row * stride + column] = 1;
        error[row * stride + column] = clamp_error(args.error[pixel]);
      }
    }
  }

  bool is_finished() const {
    return std::all_of(transmittance, transmittance + rows * stride, [](float t) { return t < 0; });
  }
};

HWY_INLINE IntVec units_of(Lanes value) {
  return hn::ConvertTo(IntTag(), (value * Lanes(kScoreUnits) + Lanes(0.5f)).v);
}

/// Steps the pixels of `vectors` of `rows` over one splat, and sums.
HWY_INLINE ScoreSums score_rows(TileErrors& tile, const Splat& splat, const PixelSpan& rows, const PixelSpan& vectors) {
  const auto shape = splat_shape<Lanes>(splat);
  const int lanes = lane_count();
  ScoreSums sums{0, 0, 0};
  for (int row = rows.begin; row < rows.end; ++row) {
    const Lanes pixel_y(static_cast<float>(tile.rect.y_begin + row) + 0.5f);
    for (int v = vectors.begin; v < vectors.end; ++v) {
      const Lanes pixel_x = Lanes::iota(static_cast<float>(tile.rect.x_begin + v * lanes) + 0.5f);
      const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, pixel_y);
      if (none(footprint.contributes)) continue;
      const int p = row * tile.stride + v * lanes;
      Lanes transmittance = Lanes::load(tile.transmittance + p);
      const Lanes weight =
          blend_weight_over(transmittance, footprint.contributes, evaluate_alpha(footprint.power).alpha);
      transmittance.store(tile.transmittance + p);
      static_assert(std::int64_t{kMaxLanes} * kScoreMax < std::int64_t{1} << 31, "a vector's sum fits into 32 bits");
      const IntTag di;
      sums.weight += static_cast<std::uint64_t>(hn::GetLane(hn::SumOfLanes(di, units_of(weight))));
      sums.error +=
          static_cast<std::uint64_t>(hn::GetLane(hn::SumOfLanes(di, units_of(weight * Lanes::load(tile.error + p)))));
      sums.max_weight = std::max(sums.max_weight, hn::GetLane(hn::MaxOfLanes(FloatTag(), weight.v)));
    }
  }
  return sums;
}

}  // namespace

void run_score(const ScoreArgs& args, std::int64_t index) {
  constexpr std::int64_t kCheckInterval = 32;  // entries between tests whether all pixels are finished
  TileErrors tile;
  tile.begin(args, static_cast<std::int32_t>(index));
  const auto left = static_cast<float>(tile.rect.x_begin), top = static_cast<float>(tile.rect.y_begin);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  bool is_finished = false;
  for (std::int64_t i = first; i < last; ++i) {
    ScoreSums sums{0, 0, 0};
    if ((i - first) % kCheckInterval == 0 && !is_finished) is_finished = tile.is_finished();
    if (!is_finished) {
      const std::int32_t id = args.bins.splat_ids[i];
      const Splat& splat = args.splats[id];
      sums = score_rows(tile, splat, pixels_reached(splat.mean_y, args.extents[id].y, top, 0, tile.rows),
                        vectors_reached(splat.mean_x, args.extents[id].x, left, args.grid.tile.width));
    }
    args.sums[args.bins.pair_slots[i]] = sums;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_score);

namespace cpu {

void score(const ScoreArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) { HWY_DYNAMIC_DISPATCH(run_score)(args, tile); });
}

namespace {

constexpr std::int64_t kGrain = 1024;

/// Of a splat's pairs, [first, last).
ScoreSums sum_slots(const ScoreSums* first, const ScoreSums* last) {
  ScoreSums whole{0, 0, 0};
  for (const ScoreSums* part = first; part != last; ++part) {
    whole.error += part->error;
    whole.weight += part->weight;
    whole.max_weight = std::max(whole.max_weight, part->max_weight);
  }
  return whole;
}

}  // namespace

void add_scores(const AddScoresArgs& args) {
  parallel_each(args.n_splats, kGrain, [&](std::int64_t m) {
    if (is_across_the_seam(args.splats, m)) return;
    const bool has_second = m + 1 < args.n_splats && is_across_the_seam(args.splats, m + 1);
    const std::int64_t last = has_second ? m + 2 : m + 1;
    const ScoreSums whole = args.slot_offsets == nullptr
                                ? args.sums[m]
                                : sum_slots(args.sums + args.slot_offsets[m], args.sums + args.slot_offsets[last]);
    b3dgs::add_scores(whole, args.out, args.splats[m].gaussian);
  });
}

void sum_scores(const SumScoresArgs& args) {
  parallel_chunks(args.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::memset(static_cast<void*>(args.out + begin), 0, static_cast<std::size_t>(end - begin) * sizeof(ScoreSums));
    for (std::int64_t m = begin; m < end; ++m) {
      const ScoreSums whole = sum_slots(args.sums + args.slot_offsets[m], args.sums + args.slot_offsets[m + 1]);
      args.out[m].error = whole.error;
      args.out[m].weight = whole.weight;
      args.out[m].max_weight = whole.max_weight;
    }
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
