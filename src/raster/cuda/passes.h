// The passes of the CUDA rasterizer. Each is a function of its arguments and runs on context.stream without waiting,
// except where its comment says so; the order is rasterize_cuda.cpp's.
#pragma once

#include "raster/args.h"
#include "raster/cuda/device_buffer.h"

namespace b3dgs::cuda {

/// Totals of one view, read by the host once per step.
struct ViewCounts {
  std::int64_t n_splats;    // M
  std::int64_t n_isects;    // (tile, splat) pairs
  std::int64_t not_finite;  // smallest index of a Gaussian without a finite projection, or n_gaussians
};

/// One Gaussian's share in the binning.
struct ProjectOutputs {
  Splat* splats = nullptr;          // [N] rows of seen Gaussians are written
  Vec2f* extents = nullptr;         // [N] likewise
  std::int32_t* radii = nullptr;    // [N] 0 if not seen
  std::int32_t* n_tiles = nullptr;  // [N] tiles touched, 0 if not seen
  // [N] bit pattern of the depth, 0 if not seen. Depths are positive: their bit patterns are ordered as they are.
  std::uint32_t* depth_bits = nullptr;
  ViewCounts* counts = nullptr;  // [1]
};

/// Colours of the splats that a view sees.
struct ColorCudaArgs {
  GaussianArrays gaussians{};
  Vec3f camera_center{};  // world
  int sh_degree = 0;
  // Red, green, blue and clamped are to be written where a splat is seen, and not_finite where a colour is not.
  ProjectOutputs projected{};
};

/// Finds the colours in project()'s place, for whoever has something to do with the harmonics of what a view sees.
class ColorPass {
 public:
  virtual ~ColorPass() = default;
  virtual void color(const ColorCudaArgs& args, const LaunchContext& context) = 0;
};

struct ProjectCudaArgs {
  GaussianArrays gaussians{};
  PinholeView view{};
  int sh_degree = 0;
  float near_plane = kNearPlane;
  Culling culling = Culling::kEllipse;
  TileGrid grid{};
  ProjectOutputs out{};
  ColorPass* color_pass = nullptr;  // null: project() finds the colours
};
void project(const ProjectCudaArgs& args, const LaunchContext& context);

/// Buffers that binning fills and keeps from view to view.
struct BinBuffers {
  DeviceBuffer<std::uint32_t> depths, depths_sorted;
  DeviceBuffer<std::int32_t> visible, visible_sorted, rank_of_gaussian, splat_ids, tile_of_bucket;
  DeviceBuffer<std::int64_t> slot_offsets, isect_slots, tile_offsets, bucket_offsets;
  DeviceBuffer<unsigned long long> n_buckets;
  DeviceBuffer<Splat> splats;
  DeviceBuffer<Vec2f> extents;
  DeviceBuffer<unsigned char> temporary;  // CUB's, for what has a row for each Gaussian

  template <class Visit>
  void visit_buffers(Visit&& visit) {
    visit(depths), visit(depths_sorted), visit(visible), visit(visible_sorted), visit(rank_of_gaussian);
    visit(splat_ids), visit(tile_of_bucket), visit(slot_offsets), visit(isect_slots), visit(tile_offsets);
    visit(bucket_offsets), visit(n_buckets), visit(splats), visit(extents), visit(temporary);
  }
};

struct BinCudaArgs {
  ProjectOutputs projected{};
  std::int64_t n_gaussians = 0, n_splats = 0, n_isects = 0;
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  bool keep_slots = false;  // fill isect_slots
};

/// Runs of 32 entries of a tile's list, the last one of a list being shorter. Those of a tile are numbered one after
/// the other; the tiles come in any order.
struct Buckets {
  const std::int64_t* offsets = nullptr;         // [n_tiles] number of each tile's first bucket
  const std::int32_t* tile_of_bucket = nullptr;  // [n]
  const unsigned long long* n = nullptr;         // [1] how many there are
  std::int64_t n_max = 0;                        // bound on that number that the host knows
};

/// Splats in order of depth, and the tiles' lists of them.
struct BinnedView {
  const Splat* splats = nullptr;                   // [M] nearest first; equal depths in the order of the Gaussians
  const Vec2f* extents = nullptr;                  // [M]
  const std::int32_t* rank_of_gaussian = nullptr;  // [N] place in `splats`; undefined where radii is 0
  BinnedSplats bins{};                             // isect_slots is null unless asked for
  Buckets buckets{};
};

/// Lists what the view sees in `buffers` (visible, depths): the part of binning that needs no count from the host.
void list_seen(const ProjectOutputs& projected, std::int64_t n_gaussians, BinBuffers& buffers,
               const LaunchContext& context);

/// After list_seen(), the rest. Pairs are sorted in `scratch`; what it returns is not there.
BinnedView bin(const BinCudaArgs& args, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context);

/// What the per-splat backward pass needs from the forward pass: for each pixel, what each bucket of 32 list entries
/// adds to it. Written up to the bucket of the pixel's last splat. A bucket's own part, not the sum so far: what lies
/// behind a bucket is then a sum of parts, where a difference of two sums would lose the digits of what little light
/// shows.
struct BucketParts {
  // [n_buckets, tile pixels row by row] transmittance behind the bucket (undefined if none of its splats was blended);
  // red, green, blue that it adds. Null: no parts are kept.
  float4* light = nullptr;
  float* depth = nullptr;  // likewise: depth that it adds; null: no gradient by depth will be asked for
  // Where a list was cut into segments, its parts have to be multiplied by what reaches the segment.
  const std::int32_t* first_segment_of_tile = nullptr;  // [n_tiles] -1: not cut. Null: no list is
  const float* before_segment = nullptr;                // Segments::before
};

/// `segmented` cuts lists of more entries than this into segments of so many: whole buckets.
inline constexpr std::int32_t kSegmentEntries = 1024;

/// A segment of a tile's list; the first one may be the whole list.
struct SegmentTask {
  std::int32_t tile, segment;  // the segment's number within the list
};

/// Scratch of `segmented`. Segments of a tile follow one another; there may be unused numbers between those of two. A
/// list of more entries than one segment's is cut into at most 2 entries / kSegmentEntries, so that numbers are below
/// n = 2 n_isects / kSegmentEntries.
struct Segments {
  std::int32_t n_tasks_max = 0;           // bound on the number of tasks that the host knows
  SegmentTask* tasks = nullptr;           // [n_tasks_max] second segments of all lists, then third ones, ...
  std::int32_t* n_tasks = nullptr;        // [1]
  std::int32_t* first_of_tile = nullptr;  // [n_tiles] first segment; -1: the list is not cut
  std::int32_t* is_done = nullptr;        // [n] 1 once the segment is blended
  // [n, tile pixels row by row]
  // Transmittance before the segment; 1 where the segment ends the pixel or lies behind. Between join and end negated
  // where the segment ends the pixel, with what is blended before it in `shown` and `last`.
  float* before = nullptr;
  float* transmittance = nullptr;  // of the segment alone, negated where it ends the pixel
  float4* shown = nullptr;         // red, green, blue and depth that it adds to a pixel whose transmittance is 1
  std::int32_t* last = nullptr;    // position in the list of the last splat blended, or -1
};

struct BlendForwardCudaArgs {
  BlendForwardArgs blend{};
  Buckets buckets{};
  BucketParts parts{};
  std::int32_t* next_task = nullptr;    // [1] the pool's counter, 0 at the start
  std::uint32_t* quad_words = nullptr;  // [n_buckets_max, pixels of a tile / 4] scratch of `combined`
  Segments segments{};
};

void count_load(const CountLoadArgs& args, const LaunchContext& context);

/// A splat's sums, padded to three 16-byte words for vector atomics.
struct alignas(16) SplatGradSum {
  SplatGrad sum;
  float unused[2];
};
static_assert(sizeof(SplatGradSum) == 48, "three 16-byte words");

struct BlendBackwardCudaArgs {
  BlendBackwardArgs blend{};  // its isect_grads are not used
  Buckets buckets{};
  BucketParts parts{};
  float2* bucket_ends = nullptr;        // [n_buckets_max, tile pixels] scratch of the per-splat pass
  SplatGradSum* splat_grads = nullptr;  // [M] added to; zero before
  // [n_isects] by slot, zero before; null: gradients go to splat_grads with atomics, in an order that changes from run
  // to run. The per-splat pass alone can fill it.
  SplatGradSum* isect_grads = nullptr;
};

/// Adds each splat's records, which lie together, in one order: the way to equal bits twice.
struct SumSplatGradsArgs {
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGradSum* isect_grads = nullptr;   // [n_isects] by slot
  SplatGradSum* splat_grads = nullptr;         // [M] out
};
void sum_splat_grads(const SumSplatGradsArgs& args, const LaunchContext& context);

struct ProjectBackwardCudaArgs {
  GaussianArrays gaussians{};
  PinholeView view{};
  int sh_degree = 0;
  const std::int32_t* radii = nullptr;             // [N] 0 if not seen
  const std::int32_t* rank_of_gaussian = nullptr;  // [N]
  const Splat* splats = nullptr;                   // [M]
  const SplatGradSum* splat_grads = nullptr;       // [M]
  GaussianGradArrays grad{};
};
void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
