// The CUDA rasterizer, its passes and their arguments. Each pass is queued on context.stream and does not wait for the
// device. cuda_backend.cpp calls them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>

#include "raster/args.h"
#include "raster/cuda/device_buffer.h"
#include "raster/geometry.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cuda {

/// Makes a rasterizer that calls `context` for the stream and the memory of each pass.
std::unique_ptr<RasterizerBackend> make_rasterizer(std::function<LaunchContext()> context);

/// Counters of neighbouring tiles are this many integers apart, so that each has its own memory sector. Atomics to the
/// same sector wait for each other.
inline constexpr std::int32_t kCounterStride = 8;

/// Totals of one view, which the host reads.
struct ViewCounts {
  std::int64_t n_splats = 0;        // of visible Gaussians
  std::int64_t n_second = 0;        // splats across the seam of a panorama
  std::int64_t first_invalid = -1;  // smallest index of an invalid Gaussian, -1 if there is none
  // Set by count_lists():
  std::int64_t n_pairs = 0;                        // (tile, splat) pairs: entries of all lists
  std::int64_t n_buckets = 0;                      // of all lists
  std::int64_t longest_list = 0;                   // entries
  std::int64_t n_long_lists = 0, n_more_runs = 0;  // lists that are not short; runs of lists after the first
};

/// Outputs of projection, with a row for each of N Gaussians. A panorama has 2 N rows, where row N + i is for the
/// second splat of Gaussian i (math/project_splat.h).
struct ProjectOutputs {
  Splat* splats = nullptr;        // [rows] written only where there is a splat
  Vec2f* extents = nullptr;       // [rows] written only where there is a splat
  std::int32_t* radii = nullptr;  // [rows] 0 if there is no splat
  // [tiles + 1], kCounterStride apart: length of each tile's list minus that of the tile before it, row by row. A splat
  // adds 1 where its span of tiles in a row begins, and subtracts 1 where it ends. Null if nothing is drawn.
  std::int32_t* list_growth = nullptr;
  ViewCounts* counts = nullptr;  // [1] n_splats, n_second and first_invalid
  SplatGradSum* sums = nullptr;  // [rows] zeroed where there is a splat; null: the backward blend zeroes them
};

/// Arguments of a ColorPass.
struct ColorCudaArgs {
  GaussianArrays gaussians{};
  Vec3f camera_center{};  // world space
  int sh_degree = 0;
  ProjectOutputs projected{};    // out: red, green, blue and clamped of each visible splat
  ViewCounts* counts = nullptr;  // on the device, or in pinned memory; out: first_invalid (note_invalid())
};

/// Computes the colours of the splats instead of project(). Training uses it to update the SH coefficients of visible
/// Gaussians in the kernel that reads them.
class ColorPass {
 public:
  virtual ~ColorPass() = default;
  /// Runs concurrently with binning, so it must neither allocate nor free memory (LaunchContext::memory_stream).
  virtual void color(const ColorCudaArgs& args, const LaunchContext& context) = 0;
};

struct ProjectCudaArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  float near_plane = kNearPlane;
  Culling culling = Culling::kEllipse;
  TileGrid grid{};
  ProjectOutputs out{};
  bool with_colors = true;  // false: a ColorPass follows
  bool antialiasing = false;
};
void project(const ProjectCudaArgs& args, const LaunchContext& context);

/// Replaces project() for splats that were projected elsewhere, and numbers them row by row as if they were Gaussians.
/// The n_gaussians of `args` is the number of rows. Its parameters and colours are not used.
void load_rows(const SplatRows& rows, const ProjectCudaArgs& args, const LaunchContext& context);

/// For panoramas, after a ColorPass: copies the colours of the first N rows to the other rows.
void copy_second_colors(const ProjectOutputs& projected, std::int64_t n_gaussians, const LaunchContext& context);

/// Copies the first `capacity` rows that have a splat. Must follow list_seen().
void copy_seen(const ProjectOutputs& projected, const std::int32_t* seen, std::int64_t capacity,
               const SplatRowArrays& out, const LaunchContext& context);

/// Buffers of binning, reused for every view.
struct BinBuffers {
  DeviceBuffer<std::int32_t> seen, next_entries, first_more_runs, tiles_by_length, splat_ids, tile_of_bucket;
  DeviceBuffer<std::int64_t> slot_offsets, pair_slots, tile_offsets, bucket_offsets;
  DeviceBuffer<unsigned char> temporary;  // for CUB's algorithms
};

/// Writes the indices of the rows that have a splat to buffers.seen, in order.
void list_seen(const ProjectOutputs& projected, std::int64_t n_rows, BinBuffers& buffers, const LaunchContext& context);

/// A list entry. The upper half has the bits of its depth, the lower half the id of the splat, which is its row. Depths
/// are positive floats, which compare like their bits.
using EntryKey = std::uint64_t;

inline constexpr std::int32_t kRunEntries = 4352;       // entries that a block sorts
inline constexpr std::int32_t kShortListEntries = 512;  // shorter lists count as short, and a warp sorts them

/// Entries of a bucket, which is the task of a block in the backward pass and the unit for which the forward pass
/// stores parts. With fewer entries, more parts are written and read. With more, the load is less even.
inline constexpr std::int32_t kBucketEntries = 128;

/// Returns the number of buckets of a list of this length.
B3DGS_HD std::int32_t n_buckets_of(std::int32_t length) {
  return (length + kBucketEntries - 1) / kBucketEntries;
}

/// Buckets: kBucketEntries consecutive entries of a tile's list. The last bucket of a list may be shorter. Buckets are
/// numbered tile by tile.
struct Buckets {
  const std::int64_t* offsets = nullptr;         // [n_tiles] each tile's first bucket
  const std::int32_t* tile_of_bucket = nullptr;  // [n]
  std::int64_t n = 0;
};

/// The lists of a view, which bin.cu and sort_lists.cu make. Ids of splats are rows of ProjectOutputs, and so are the
/// indices of slot_offsets.
struct ListArgs {
  ProjectOutputs projected{};
  std::int64_t n_rows = 0;
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  // Outputs of count_lists():
  std::int64_t* tile_offsets = nullptr;     // [n_tiles + 1] start of each list
  std::int64_t* bucket_offsets = nullptr;   // [n_tiles] first bucket of each list
  std::int32_t* next_entries = nullptr;     // [n_tiles], kCounterStride apart: next free entry of each list
  std::int32_t* first_more_runs = nullptr;  // [n_tiles] number of runs after the first, over all lists before this one
  std::int32_t* tiles_by_length = nullptr;  // [n_tiles] longest list first, approximately; short ones last
  // Input and outputs of bin():
  ViewCounts counts{};
  EntryKey *keys = nullptr, *merged = nullptr;  // [n_pairs] scratch
  std::int32_t* splat_ids = nullptr;            // [n_pairs] out
  std::int32_t* tile_of_bucket = nullptr;       // [n_buckets] out
  std::int64_t* slot_offsets = nullptr;         // [n_rows + 1] out: BinnedSplats; null: no slots are computed
  std::int64_t* pair_slots = nullptr;           // [n_pairs] out, the same

  BinnedSplats bins() const { return {tile_offsets, splat_ids, pair_slots, slot_offsets, counts.n_pairs}; }
  Buckets buckets() const { return {bucket_offsets, tile_of_bucket, counts.n_buckets}; }
};

/// First part of binning, which needs no counts on the host. Computes the start of each tile's list, and all counts,
/// which it writes to pinned memory. Sets the arrays of `args` that it writes.
void count_lists(ListArgs& args, BinBuffers& buffers, ViewCounts* host_counts, const LaunchContext& context);

/// Second part of binning, given args.counts. Pairs are sorted in `scratch`, which can be reused afterwards.
void bin(ListArgs& args, bool with_slots, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context);

/// Sorts the list of each tile from args.keys (in any order) to args.splat_ids. Also fills args.tile_of_bucket.
void sort_lists(const ListArgs& args, const LaunchContext& context);

/// Forward pass data for the backward pass: the contribution of each bucket to each pixel, up to the bucket of the
/// pixel's last splat. It is stored per bucket and not as a running sum, so the sum behind a bucket is a sum of parts.
/// A difference of two running sums would lose accuracy where it is small.
struct BucketParts {
  // [n_buckets, pixels of a tile row by row] transmittance behind the bucket (finite, but meaningless if no splat of
  // the bucket was blended), and the red, green and blue that it adds. Null if no parts are stored.
  float4* color = nullptr;
  float* depth = nullptr;  // same shape: depth that it adds. Null if depth has no gradient.
  // The parts of a list that was cut into segments must be multiplied by the front of their segment.
  const std::int32_t* first_segment_of_tile = nullptr;  // [n_tiles] -1 if not cut. Null: no list is cut.
  const float* segment_fronts = nullptr;                // Segments::fronts
  int segment_buckets_log2 = 0;                         // a segment has 2^this buckets
};

/// A length that no list exceeds.
inline constexpr std::int32_t kAnyLength = std::numeric_limits<std::int32_t>::max();
/// Number of blocks that blend a segment, one for each half of a tile.
inline constexpr std::int32_t kSegmentBlocks = 2;

/// Describes how `segmented` cuts lists.
struct ListCut {
  static constexpr int kMinLog2 = 7, kMaxLog2 = 9;  // range of entries_log2; the smallest segment is a bucket
  int entries_log2 = kMinLog2;                      // a segment has 2^this entries, the last of a list maybe fewer
  std::int32_t longest_whole = kAnyLength;          // longer lists are cut. kAnyLength: none, like sub-tile
  bool cuts() const { return longest_whole < kAnyLength; }

  /// Returns the number of segments of a list, 1 if it is not cut.
  B3DGS_HD std::int32_t n_segments(std::int32_t length) const {
    return length > longest_whole ? ((length - 1) >> entries_log2) + 1 : 1;
  }
  /// Returns an upper bound of the number of segments of lists that have this many entries in total, and so the index
  /// of the first segment after them. A list that is cut has more than two segments, so the bound is 1.5 times the
  /// entries divided by the segment length.
  B3DGS_HD std::int64_t segments_before(std::int64_t entries) const { return 3 * entries >> (entries_log2 + 1); }
};

/// Decides which lists to cut. Blocks take the longest list first. If that list exceeds a multiprocessor's share of all
/// entries, it would finish last, so long lists are cut. The length of a segment is the largest power of two up to a
/// quarter of the share, within 2^kMinLog2 and 2^kMaxLog2 (measured: docs/lab/kernels.md). Lists longer than both a
/// quarter of the share and two segments are cut. Cutting a list blends some of its entries twice, so a list of up to
/// two segments is never cut.
inline ListCut list_cut(const ViewCounts& counts, int n_multiprocessors) {
  const std::int64_t quarter = counts.n_pairs / (4 * n_multiprocessors);
  ListCut cut;
  while (cut.entries_log2 < ListCut::kMaxLog2 && (std::int64_t{2} << cut.entries_log2) <= quarter) ++cut.entries_log2;
  const std::int64_t two_segments = std::int64_t{2} << cut.entries_log2;
  if (counts.longest_list > std::max(two_segments, 4 * quarter)) {
    cut.longest_whole = static_cast<std::int32_t>(std::max(two_segments, quarter));
  }
  return cut;
}

/// One segment of a tile's list. Segment 0 may be the whole list.
struct SegmentTask {
  std::int32_t tile, segment;  // index of the segment within the list
};

/// Memory of `segmented`. The segments of a tile have consecutive indices. There may be unused indices between tiles
/// (ListCut::segments_before()).
struct Segments {
  std::int32_t n_max = 0;                 // n, an upper bound of the indices
  std::int32_t n_tasks_max = 0;           // upper bound of the number of tasks
  SegmentTask* tasks = nullptr;           // [n_tasks_max] the second segments of all lists, then the third, ...
  std::int32_t* n_tasks = nullptr;        // [1]
  std::int32_t* n_long = nullptr;         // [1] number of lists that are at least as long as a segment
  std::int32_t* first_of_tile = nullptr;  // [n_tiles] index of the first segment, -1 if the list is not cut
  std::int32_t* hidden_from = nullptr;    // [n_tiles, kSegmentBlocks] segments from this index on are hidden
  std::int32_t* is_done = nullptr;        // [n, kSegmentBlocks] 1 when the block has blended the segment
  // The following are [n, pixels of a tile row by row], and undefined behind the segment in which the pixel finishes.
  // `fronts` is the factor of the segment's bucket parts: the transmittance in front, or 1 if the segment was blended
  // again. Null if no parts are stored.
  float* fronts = nullptr;
  float* transmittance = nullptr;  // of the segment alone; negative if it finishes the pixel, as in PixelState
  float4* color_depth = nullptr;   // contribution to a pixel whose transmittance is 1
  std::int32_t* last = nullptr;    // position in the list of the last splat blended, or -1
};

struct BlendForwardCudaArgs {
  BlendForwardArgs blend{};
  Buckets buckets{};
  const std::int32_t* tiles_by_length = nullptr;  // [n_tiles] a permutation (ListArgs)
  ListCut cut{};                                  // for `segmented`
  BucketParts parts{};
  Segments segments{};
};

void count_load(const CountLoadArgs& args, const LaunchContext& context);

/// Adds the scores of the view to args.sums, which are indexed by row and must be zero before. Without `wants_weights`,
/// sums of weights stay 0.
void score(const ScoreArgs& args, const std::int32_t* tiles_by_length, bool wants_weights,
           const LaunchContext& context);
/// Adds the sums of each row to the scores of its Gaussian. Rows with radius 0 are skipped, unless `radii` is null.
void add_scores(const AddScoresArgs& args, const std::int32_t* radii, const LaunchContext& context);

/// Computes the planes of the rows that have a splat. `planes`: [n_rows] out, written only there.
void splat_planes(const PlaneArgs& args, const ProjectOutputs& projected, std::int64_t n_rows, PlaneRow* planes,
                  const LaunchContext& context);
/// Computes depth, normals and confidence of the surface that a view shows.
void geometry(const GeometryArgs& args, const std::int32_t* tiles_by_length, const LaunchContext& context);

struct BlendBackwardCudaArgs {
  BlendBackwardArgs blend{};  // its pair_grads are not used
  Buckets buckets{};
  BucketParts parts{};
  SplatGradSum* splat_grads = nullptr;  // [rows] added to; must be zero where there is a splat
  // Scratch of per-bucket, [n_buckets, pixels of a tile row by row]: ReverseState::behind for each bucket of a list
  // that is not short (kShortListEntries). Null for per-pixel, or if not has_many_parts().
  float* behind = nullptr;
  const std::int32_t* tiles_by_length = nullptr;  // ListArgs; used with `behind`
  std::int32_t n_long_lists = 0;                  // ViewCounts; used with `behind`
  // [n_pairs] indexed by slot, must be zero. If null, gradients are added to splat_grads with atomics, in an order that
  // changes from run to run. per-pixel always does that.
  SplatGradSum* pair_grads = nullptr;
};

/// Sums the pair gradients of each splat in a fixed order, so that repeated runs give the same bits. `slot_offsets`:
/// [n_rows + 1]. `pair_grads`: [n_pairs] indexed by slot. `sums`: [n_rows] out.
void sum_splat_grads(std::int64_t n_rows, const std::int64_t* slot_offsets, const SplatGradSum* pair_grads,
                     SplatGradSum* sums, const LaunchContext& context);

/// For panoramas: adds the sums of row N + i to those of row i. `radii` and `sums` are [2 N].
template <class Sums>
void join_second(std::int64_t n_gaussians, const std::int32_t* radii, Sums* sums, const LaunchContext& context);

/// For RenderSettings::inverse_depth (math/project_splat.h): runs after binning, and after the backward blend. All
/// arrays are [n_rows]. Rows with radius 0 have no splat.
void invert_depths(std::int64_t n_rows, const std::int32_t* radii, Splat* splats, const LaunchContext& context);
void invert_depth_gradients(std::int64_t n_rows, const std::int32_t* radii, const Splat* splats, SplatGradSum* sums,
                            const LaunchContext& context);

struct ProjectBackwardCudaArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  const std::int32_t* radii = nullptr;        // [N] 0 if not visible
  const Splat* splats = nullptr;              // [N]
  const SplatGradSum* splat_grads = nullptr;  // [N]
  GaussianGradArrays grad{};
  bool antialiasing = false;
};
void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context);

/// Replaces project_backward(): stores the sums of the splats for a later one. `n_records`: [1] scratch.
void keep_splat_records(const ProjectBackwardCudaArgs& args, std::int32_t* n_records, const SplatRecordArrays& out,
                        const LaunchContext& context);

/// The same for splats rendered elsewhere.
void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context);

/// Arguments of the gradient with respect to the camera's pose (math/gaussian_grad.h).
struct CameraGradientArgs {
  ProjectBackwardCudaArgs backward{};  // its `grad` is not used
  // [M] rows of the splats. Second splats are skipped, because their sums are in the first. Null: all M rows.
  const std::int32_t* seen = nullptr;
  std::int64_t n_splats = 0;     // M
  double* parts = nullptr;       // [kCameraGradientParts, kCameraGradients] scratch, a sum per block
  double* out = nullptr;         // [kCameraGradients] out
  float* splat_parts = nullptr;  // [M, kCameraGradients] out: contribution of each splat; null: not stored
};
inline constexpr int kCameraGradientParts = 1024;
void camera_gradient(const CameraGradientArgs& args, const LaunchContext& context);

/// Sums the contributions of all splats in the order of camera_gradient(), with the same `parts` and `out`.
void sum_camera_parts(const float* splat_parts, std::int64_t n_splats, double* parts, double* out,
                      const LaunchContext& context);

}  // namespace b3dgs::cuda
