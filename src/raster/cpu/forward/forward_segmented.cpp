// Forward blend, segmented: shared-memory, with long lists cut into segments that are blended independently, so that
// threads finish at about the same time even if one tile holds most of the work.
//   Why it works: compositing is associative. A segment is blended as if the transmittance in front of it were 1; the
//     (transmittance, colour) of a tile's segments are then combined front to back.
//   Phase 1: threads take tasks from an atomic counter: segments of long lists first, then whole short lists. Lanes,
//     staging and row culling are those of shared-memory.
//   Phase 2: threads take long lists and join their segments. The stop at transmittance 1e-4 is not associative: a
//     segment in which a pixel finishes is blended again, onto the state in front of it.
//   Memory: the pixels of every segment, between the phases.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_segmented.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/staged_splats-inl.h"

#include <new>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"

#ifndef B3DGS_RASTER_CPU_SEGMENT_
#define B3DGS_RASTER_CPU_SEGMENT_
namespace b3dgs::cpu {

/// Entries [begin, end) of a tile's list.
struct Segment {
  std::int64_t tile, begin, end;
};

/// Raw memory for a TilePixels, whose type and size differ between instruction sets.
struct alignas(64) SegmentPixels {
  std::byte bytes[25 * 1024];  // 6 planes of 32 x 32 pixels and their bounds; checked in run_segment()
};

}  // namespace b3dgs::cpu
#endif

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

/// Blends a list that is not cut.
void run_whole_list(const BlendForwardArgs& args, const cpu::Segment& list) {
  TilePixels tile;
  tile.begin(args.grid, static_cast<std::int32_t>(list.tile));
  blend_staged(args, list.tile, list.begin, list.end, tile);
  tile.finish(args);
}

void run_segment(const BlendForwardArgs& args, const cpu::Segment& segment, cpu::SegmentPixels& memory) {
  static_assert(sizeof(TilePixels) <= sizeof(memory) && alignof(TilePixels) <= alignof(cpu::SegmentPixels),
                "SegmentPixels must hold a TilePixels");
  TilePixels& tile = *new (memory.bytes) TilePixels;
  tile.begin(args.grid, static_cast<std::int32_t>(segment.tile));
  blend_staged(args, segment.tile, segment.begin, segment.end, tile);
}

/// Whether any unfinished pixel of `tile` would finish within the segment.
HWY_INLINE bool finishes_a_pixel(const TilePixels& tile, const TilePixels& segment) {
  for (int p = 0; p < tile.rows * tile.stride; p += lane_count()) {
    const Lanes before = Lanes::load(tile.transmittance + p), own = Lanes::load(segment.transmittance + p);
    const LaneMask finishes = (before > Lanes(0.0f)) & !(before * own >= Lanes(kTransmittanceMin));
    if (!none(finishes)) return true;
  }
  return false;
}

/// Combines `tile` with a segment behind it in which no pixel finishes.
HWY_INLINE void join(TilePixels& tile, const TilePixels& segment) {
  for (int p = 0; p < tile.rows * tile.stride; p += lane_count()) {
    const Lanes before = Lanes::load(tile.transmittance + p);
    const LaneMask alive = before > Lanes(0.0f);
    const Lanes weight = select(alive, before, Lanes(0.0f));
    const auto add = [&](float* sum, const float* own)
                         HWY_ATTR { multiply_add(weight, Lanes::load(own + p), Lanes::load(sum + p)).store(sum + p); };
    add(tile.red, segment.red);
    add(tile.green, segment.green);
    add(tile.blue, segment.blue);
    add(tile.depth, segment.depth);
    select(alive, before * Lanes::load(segment.transmittance + p), before).store(tile.transmittance + p);
    for (int lane = p; lane < p + lane_count(); ++lane) {
      if (tile.transmittance[lane] > 0 && segment.last[lane] >= 0) tile.last[lane] = segment.last[lane];
    }
  }
}

/// Joins the `count` segments of one list and writes the tile.
void run_join(const BlendForwardArgs& args, const cpu::Segment* segments, const cpu::SegmentPixels* pixels,
              std::int64_t count) {
  TilePixels tile;
  tile.begin(args.grid, static_cast<std::int32_t>(segments->tile));
  for (std::int64_t k = 0; k < count; ++k) {
    const auto& segment = *std::launder(reinterpret_cast<const TilePixels*>(pixels[k].bytes));
    if (finishes_a_pixel(tile, segment)) {
      blend_staged(args, segments[k].tile, segments[k].begin, segments[k].end, tile);
    } else {
      join(tile, segment);
    }
  }
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_whole_list);
HWY_EXPORT(run_segment);
HWY_EXPORT(run_join);

namespace cpu {

void blend_forward_segmented(const BlendForwardArgs& args) {
  // Segment length: about a millisecond of work on a crowded tile, long compared to the overhead of a task.
  constexpr std::int64_t kEntries = 4096;
  std::vector<Segment> segments, whole_lists;
  std::vector<std::size_t> firsts;  // first segment of each list that is cut, and the number of segments
  for (std::int64_t tile = 0; tile < args.grid.n_tiles(); ++tile) {
    const std::int64_t n = args.bins.tile_offsets[tile + 1] - args.bins.tile_offsets[tile];
    if (n <= kEntries) {
      whole_lists.push_back({tile, 0, n});
      continue;
    }
    firsts.push_back(segments.size());
    for (std::int64_t begin = 0; begin < n; begin += kEntries) {
      segments.push_back({tile, begin, std::min(begin + kEntries, n)});
    }
  }
  firsts.push_back(segments.size());

  std::vector<SegmentPixels> pixels(segments.size());
  const auto n_segments = static_cast<std::int64_t>(segments.size());
  parallel_pool(n_segments + static_cast<std::int64_t>(whole_lists.size()), [&](std::int64_t task, int) {
    const auto own = static_cast<std::size_t>(task);
    if (task < n_segments) {
      HWY_DYNAMIC_DISPATCH(run_segment)(args, segments[own], pixels[own]);
    } else {
      HWY_DYNAMIC_DISPATCH(run_whole_list)(args, whole_lists[own - segments.size()]);
    }
  });
  parallel_pool(static_cast<std::int64_t>(firsts.size()) - 1, [&](std::int64_t list, int) {
    const std::size_t first = firsts[static_cast<std::size_t>(list)], end = firsts[static_cast<std::size_t>(list) + 1];
    HWY_DYNAMIC_DISPATCH(run_join)(args, &segments[first], &pixels[first], static_cast<std::int64_t>(end - first));
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
