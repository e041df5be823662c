// Sorts the list of each tile, after bin.cu has written it in any order, and notes the tile of each bucket.
#pragma once

#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

/// A list entry: the bits of its depth in the upper half, the splat's id in the lower. Depths are positive floats,
/// which compare like their bits.
using EntryKey = std::uint64_t;

inline constexpr std::int32_t kRunEntries = 4352;       // what a block sorts
inline constexpr std::int32_t kShortListEntries = 512;  // a list of fewer is short: a warp sorts it

struct SortListsArgs {
  const std::int64_t* tile_offsets = nullptr;     // [n_tiles + 1]
  const std::int32_t* first_more_runs = nullptr;  // [n_tiles] number of runs after the first of the lists in front
  const std::int32_t* tiles_by_length = nullptr;  // [n_tiles]
  std::int32_t n_tiles = 0, n_ids = 0;
  ViewCounts counts{};
  const std::int64_t* bucket_offsets = nullptr;  // [n_tiles]
  std::int32_t* tile_of_bucket = nullptr;        // [n_buckets] out
  EntryKey *keys = nullptr, *merged = nullptr;   // [n_pairs] in, and scratch; undefined afterwards
  std::int32_t* splat_ids = nullptr;             // [n_pairs] out
};
void sort_lists(const SortListsArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
