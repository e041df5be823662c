// Binning: makes a list of splats for each tile, nearest first.
//
//   splats      in the order of the Gaussians
//     | sort    stable radix sort by depth
//   splats      nearest first
//     | find    the tiles that each splat touches, and how many splats touch each tile
//   tiles       of the first splat, of the second, ...
//     | place   each splat into the lists of its tiles with a stable counting sort
//   lists       and the slot of each entry; the slots of a splat are contiguous
//
// Every step is split into consecutive chunks, one per thread. A chunk knows where to write from the counts of the
// chunks before it, so the lists do not depend on the number of threads.

#include <algorithm>
#include <cstring>
#include <utility>
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
constexpr std::int64_t kPrefetch = 16;  // splats to prefetch

/// Sorts keys by their upper 32 bits. Returns the array with the result.
std::uint64_t* sort_by_depth(std::uint64_t* keys, std::uint64_t* swap, std::int64_t n) {
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<std::int64_t> counts(static_cast<std::size_t>(chunks.count * kDigits));
  for (int shift = 32; shift < 64; shift += kDigitBits) {
    parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
      std::int64_t* const count = counts.data() + chunk * kDigits;
      std::fill(count, count + kDigits, 0);
      for (std::int64_t i = chunks.begin(chunk), end = chunks.end(chunk); i < end; ++i) {
        ++count[keys[i] >> shift & (kDigits - 1)];
      }
    });
    std::int64_t total = 0;
    for (int digit = 0; digit < kDigits; ++digit) {
      for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
        total += std::exchange(counts[static_cast<std::size_t>(chunk * kDigits + digit)], total);
      }
    }
    parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
      std::int64_t* const next = counts.data() + chunk * kDigits;
      for (std::int64_t i = chunks.begin(chunk), end = chunks.end(chunk); i < end; ++i) {
        swap[next[keys[i] >> shift & (kDigits - 1)]++] = keys[i];
      }
    });
    std::swap(keys, swap);
  }
  return keys;
}

std::int32_t splat_of(std::uint64_t key) {
  return static_cast<std::int32_t>(key & 0xffffffffu);
}

}  // namespace

BinnedSplats bin(const BinArgs& args, BinBuffers& buffers) {
  const std::int64_t n = args.n_splats, n_tiles = args.grid.n_tiles();
  std::uint64_t* keys = buffers.keys.resize(n);
  parallel_each(n, kGrain, [&](std::int64_t m) {
    std::uint32_t depth_bits;  // positive floats compare like their bit patterns
    std::memcpy(&depth_bits, &args.splats[m].depth, sizeof depth_bits);
    keys[m] = std::uint64_t{depth_bits} << 32 | static_cast<std::uint64_t>(m);
  });
  keys = sort_by_depth(keys, buffers.keys_swap.resize(n), n);

  // In depth order, the data of a splat is scattered in memory, so it is prefetched some splats ahead.
  const auto ahead = [&](std::int64_t depth_index) { return splat_of(keys[std::min(depth_index + kPrefetch, n - 1)]); };

  // Find the tiles. Counts are per chunk and tile, and per splat.
  const Chunks chunks = make_chunks(n, kGrain);
  std::int64_t* const counts = buffers.tile_counts.resize(chunks.count * n_tiles);
  std::int64_t* const slot_offsets = buffers.slot_offsets.resize(n + 1);
  buffers.tiles.resize(std::max(buffers.tiles.size(), static_cast<std::size_t>(chunks.count)));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::int64_t* const count = counts + chunk * n_tiles;
    std::fill(count, count + n_tiles, 0);
    std::vector<std::int32_t> tiles = std::move(buffers.tiles[static_cast<std::size_t>(chunk)]);
    tiles.clear();
    std::int64_t n_pairs = 0;
    for (std::int64_t depth_index = chunks.begin(chunk), end = chunks.end(chunk); depth_index < end; ++depth_index) {
      prefetch_object(args.splats[ahead(depth_index)]);
      prefetch_object(args.extents[ahead(depth_index)]);
      prefetch_object(slot_offsets[ahead(depth_index)]);
      const std::int32_t m = splat_of(keys[depth_index]);
      const Splat& splat = args.splats[m];
      const std::int32_t radius = args.culling == Culling::kSquare ? args.radii[splat.gaussian] : 0;
      std::int64_t pairs = 0;
      visit_tile_rows(args.grid, args.culling, splat, args.extents[m], radius, [&](std::int32_t row, Span span) {
        pairs += span.end - span.begin;
        for (std::int32_t column = span.begin; column < span.end; ++column) {
          const std::int32_t tile = row * args.grid.columns + column;
          ++count[tile];
          if (n_pairs + pairs <= args.n_pairs_max) tiles.push_back(tile);
        }
      });
      slot_offsets[m] = pairs;
      n_pairs += pairs;
    }
    buffers.tiles[static_cast<std::size_t>(chunk)] = std::move(tiles);
  });

  // Turn counts into offsets: where each chunk writes in each tile's list, and each splat's first slot.
  std::int64_t* const tile_offsets = buffers.tile_offsets.resize(n_tiles + 1);
  std::int64_t n_pairs = 0;
  for (std::int64_t tile = 0; tile < n_tiles; ++tile) {
    tile_offsets[tile] = n_pairs;
    for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
      n_pairs += std::exchange(counts[chunk * n_tiles + tile], n_pairs);
    }
  }
  tile_offsets[n_tiles] = n_pairs;
  if (n_pairs > args.n_pairs_max) {
    const std::int64_t m = std::max_element(slot_offsets, slot_offsets + n) - slot_offsets;
    throw NumericError(too_many_pairs(n_pairs, {args.splats[m].gaussian, slot_offsets[m]}, n_tiles, args.indexed));
  }
  std::int64_t slots = 0;
  for (std::int64_t m = 0; m < n; ++m) slots += std::exchange(slot_offsets[m], slots);
  slot_offsets[n] = slots;
  B3DGS_CHECK(slots == n_pairs, "pairs counted by splat: ", slots, ", by tile: ", n_pairs);

  // Place the splats.
  std::int32_t* const splat_ids = buffers.splat_ids.resize(n_pairs);
  std::int64_t* const pair_slots = buffers.pair_slots.resize(n_pairs);
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::int64_t* const next = counts + chunk * n_tiles;
    const std::int32_t* tile = buffers.tiles[static_cast<std::size_t>(chunk)].data();
    for (std::int64_t depth_index = chunks.begin(chunk), end = chunks.end(chunk); depth_index < end; ++depth_index) {
      prefetch_object(slot_offsets[ahead(depth_index)]);
      const std::int32_t m = splat_of(keys[depth_index]);
      for (std::int64_t slot = slot_offsets[m]; slot < slot_offsets[m + 1]; ++slot) {
        const std::int64_t position = next[*tile++]++;
        splat_ids[position] = m;
        pair_slots[position] = slot;
      }
    }
  });
  return {tile_offsets, splat_ids, pair_slots, slot_offsets, n_pairs};
}

}  // namespace b3dgs::cpu
