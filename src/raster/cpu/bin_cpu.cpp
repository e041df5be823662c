// Binning: a stable radix sort of the splats by depth, then a stable counting sort of the (tile, splat) pairs by tile.
// Both are split into consecutive chunks, so the lists do not depend on the number of threads.

#include <algorithm>
#include <cstring>
#include <vector>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs::cpu {
namespace {

constexpr int kDigitBits = 11;  // three passes sort 32 bits, and a chunk's counters fit into the first-level cache
constexpr int kDigits = 1 << kDigitBits;
constexpr std::int64_t kGrain = 8192;   // splats per chunk
constexpr std::int64_t kPrefetch = 16;  // splats to fetch ahead

/// Sorts keys by their upper 32 bits. Returns the array that holds the result.
std::uint64_t* sort_by_depth(std::uint64_t* keys, std::uint64_t* swap, std::int64_t n) {
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<std::int64_t> counts(static_cast<std::size_t>(chunks.count * kDigits));
  for (int shift = 32; shift < 64; shift += kDigitBits) {
    parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
      std::int64_t* const count = counts.data() + chunk * kDigits;
      std::fill(count, count + kDigits, 0);
      for (std::int64_t i = chunks.begin(chunk); i < chunks.end(chunk); ++i) {
        ++count[keys[i] >> shift & (kDigits - 1)];
      }
    });
    std::int64_t total = 0;
    for (int digit = 0; digit < kDigits; ++digit) {
      for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
        std::int64_t& count = counts[static_cast<std::size_t>(chunk * kDigits + digit)];
        const std::int64_t first = total;
        total += count;
        count = first;
      }
    }
    parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
      std::int64_t* const next = counts.data() + chunk * kDigits;
      for (std::int64_t i = chunks.begin(chunk); i < chunks.end(chunk); ++i) {
        swap[next[keys[i] >> shift & (kDigits - 1)]++] = keys[i];
      }
    });
    std::swap(keys, swap);
  }
  return keys;
}

}  // namespace

BinnedSplats bin(const BinArgs& args, BinBuffers& buffers, const PairLimit& limit) {
  const std::int64_t n = args.n_splats, n_tiles = args.grid.n_tiles();
  std::uint64_t* keys = buffers.keys.resize(n);
  parallel_chunks(n, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      std::uint32_t depth_bits;  // positive floats compare like their bit patterns
      std::memcpy(&depth_bits, &args.splats[m].depth, sizeof depth_bits);
      keys[m] = std::uint64_t{depth_bits} << 32 | static_cast<std::uint64_t>(m);
    }
  });
  keys = sort_by_depth(keys, buffers.keys_swap.resize(n), n);
  std::int64_t* const slot_offsets = buffers.slot_offsets.resize(n + 1);

  const auto visit_splat = [&](std::int64_t depth_index, auto&& visit) {
    // In depth order the splats are scattered in memory, so fetch them some splats ahead.
    const std::uint64_t ahead = keys[std::min(depth_index + kPrefetch, n - 1)] & 0xffffffffu;
    __builtin_prefetch(&args.splats[ahead]);
    __builtin_prefetch(&args.extents[ahead]);
    __builtin_prefetch(&slot_offsets[ahead]);
    const auto m = static_cast<std::int32_t>(keys[depth_index] & 0xffffffffu);
    const Splat& splat = args.splats[m];
    visit_tile_rows(args.grid, args.culling, splat, args.extents[m], args.radii[splat.gaussian],
                    [&](std::int32_t row, TileSpan span) { visit(m, row * args.grid.columns, span); });
  };

  // Count pairs, per chunk and tile and per splat.
  const Chunks chunks = make_chunks(n, kGrain);
  std::int64_t* const counts = buffers.tile_counts.resize(chunks.count * n_tiles);
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::int64_t* const count = counts + chunk * n_tiles;
    std::fill(count, count + n_tiles, 0);
    for (std::int64_t depth_index = chunks.begin(chunk); depth_index < chunks.end(chunk); ++depth_index) {
      std::int64_t pairs = 0;
      visit_splat(depth_index, [&](std::int32_t, std::int64_t row_start, TileSpan span) {
        for (std::int32_t column = span.begin; column < span.end; ++column) ++count[row_start + column];
        pairs += span.end - span.begin;
      });
      slot_offsets[keys[depth_index] & 0xffffffffu] = pairs;
    }
  });

  // Counts to offsets: where each chunk writes in each tile's list, and each splat's first slot.
  std::int64_t* const tile_offsets = buffers.tile_offsets.resize(n_tiles + 1);
  std::int64_t n_pairs = 0;
  for (std::int64_t tile = 0; tile < n_tiles; ++tile) {
    tile_offsets[tile] = n_pairs;
    for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
      std::int64_t& count = counts[chunk * n_tiles + tile];
      const std::int64_t first = n_pairs;
      n_pairs += count;
      count = first;
    }
  }
  tile_offsets[n_tiles] = n_pairs;
  if (n_pairs > limit.n_pairs) {
    const std::int64_t m = std::max_element(slot_offsets, slot_offsets + n) - slot_offsets;
    throw NumericError(too_many_pairs(n_pairs, {args.splats[m].gaussian, slot_offsets[m]}, n_tiles, limit.indexed));
  }
  std::int64_t slots = 0;
  for (std::int64_t m = 0; m < n; ++m) {
    const std::int64_t pairs = slot_offsets[m];
    slot_offsets[m] = slots;
    slots += pairs;
  }
  slot_offsets[n] = slots;
  B3DGS_CHECK(slots == n_pairs, "pairs counted by splat: ", slots, ", by tile: ", n_pairs);

  // Write the pairs.
  std::int32_t* const splat_ids = buffers.splat_ids.resize(n_pairs);
  std::int64_t* const pair_slots = buffers.pair_slots.resize(n_pairs);
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::int64_t* const next = counts + chunk * n_tiles;
    for (std::int64_t depth_index = chunks.begin(chunk); depth_index < chunks.end(chunk); ++depth_index) {
      std::int64_t slot = slot_offsets[keys[depth_index] & 0xffffffffu];
      visit_splat(depth_index, [&](std::int32_t m, std::int64_t row_start, TileSpan span) {
        for (std::int32_t column = span.begin; column < span.end; ++column) {
          const std::int64_t position = next[row_start + column]++;
          splat_ids[position] = m;
          pair_slots[position] = slot++;
        }
      });
    }
  });
  return {tile_offsets, splat_ids, pair_slots, slot_offsets, n_pairs};
}

}  // namespace b3dgs::cpu
