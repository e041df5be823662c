// The CUDA rasterizer, and its passes and their arguments. Each pass is queued on context.stream and does not wait for
// the device. rasterize_cuda.cpp calls them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>

#include "raster/args.h"
#include "raster/cuda/device_buffer.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cuda {

/// A rasterizer that calls `context` for the stream and the memory of each pass.
std::unique_ptr<RasterizerBackend> make_rasterizer(std::function<LaunchContext()> context);

/// Counters of neighbouring tiles are this many integers apart, so that each is in a memory sector of its own: atomics
/// to the same sector wait for each other.
inline constexpr std::int32_t kCounterStride = 8;

/// Totals of one view, which the host reads.
struct ViewCounts {
  std::int64_t n_splats = 0;        // of Gaussians that the view sees
  std::int64_t n_second = 0;        // splats across the seam of a panorama
  std::int64_t first_invalid = -1;  // smallest index of an invalid Gaussian, -1 if there is none
  // After number_lists():
  std::int64_t n_pairs = 0;                        // (tile, splat) pairs: entries of all lists
  std::int64_t n_buckets = 0;                      // of all lists
  std::int64_t longest_list = 0;                   // entries
  std::int64_t n_long_lists = 0, n_more_runs = 0;  // lists that are not short; runs of lists after their first
};

/// Outputs of projection. A row per Gaussian, N in all; of a panorama 2 N, row N + i for the second splat of Gaussian i
/// (math/project_splat.h).
struct ProjectOutputs {
  Splat* splats = nullptr;        // [rows] written only where there is a splat
  Vec2f* extents = nullptr;       // [rows] written only where there is a splat
  std::int32_t* radii = nullptr;  // [rows] 0 if there is no splat
  // [tiles + 1], kCounterStride apart: length of each tile's list minus that of the tile before it, row by row. A splat
  // adds 1 where its span of tiles in a row begins, and subtracts 1 where it ends. Null: nothing is to be drawn.
  std::int32_t* list_growth = nullptr;
  ViewCounts* counts = nullptr;  // [1] n_splats, n_second and first_invalid
  SplatGradSum* sums = nullptr;  // [rows] 0 where there is a splat, for the backward blend; null: that zeroes them
};

/// Arguments of a ColorPass.
struct ColorCudaArgs {
  GaussianArrays gaussians{};
  Vec3f camera_center{};  // world space
  int sh_degree = 0;
  ProjectOutputs projected{};    // to be written: red, green, blue and clamped of each seen splat
  ViewCounts* counts = nullptr;  // on the device, or in pinned memory; to be written: first_invalid (note_invalid())
};

/// Computes the splats' colours instead of project(). Lets training update SH coefficients of seen Gaussians in the
/// same kernel that reads them.
class ColorPass {
 public:
  virtual ~ColorPass() = default;
  /// Runs beside binning: must neither allocate nor free memory (LaunchContext::memory_stream).
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

/// In place of project(): splats that were projected elsewhere, numbered as Gaussians, row by row. Of `args`,
/// n_gaussians is the number of rows; parameters and colours are not used.
void load_rows(const SplatRows& rows, const ProjectCudaArgs& args, const LaunchContext& context);

/// Of a panorama, after a ColorPass: gives the colours of the first N rows to the others.
void copy_second_colors(const ProjectOutputs& projected, std::int64_t n_gaussians, const LaunchContext& context);

/// After list_seen(): copies the first `capacity` rows that have a splat.
void copy_seen(const ProjectOutputs& projected, const std::int32_t* seen, std::int64_t capacity,
               const SplatRowArrays& out, const LaunchContext& context);

/// Buffers of binning, reused from view to view.
struct BinBuffers {
  DeviceBuffer<std::int32_t> seen, next_entries, first_more_runs, tiles_by_length, splat_ids, tile_of_bucket;
  DeviceBuffer<std::int64_t> slot_offsets, pair_slots, tile_offsets, bucket_offsets;
  DeviceBuffer<unsigned char> temporary;  // of CUB's algorithms
};

/// Writes the rows that have a splat to buffers.seen, in their order.
void list_seen(const ProjectOutputs& projected, std::int64_t n_rows, BinBuffers& buffers, const LaunchContext& context);

/// A list entry: the bits of its depth in the upper half, the splat's id, which is its row, in the lower. Depths are
/// positive floats, which compare like their bits.
using EntryKey = std::uint64_t;

inline constexpr std::int32_t kRunEntries = 4352;       // what a block sorts
inline constexpr std::int32_t kShortListEntries = 512;  // a list of fewer is short: a warp sorts it

/// Entries of a bucket: the blocks of the backward pass, and what the forward pass stores its parts for. Fewer mean
/// more parts to write and read; more, less even shares.
inline constexpr std::int32_t kBucketEntries = 128;

/// Buckets of a list of this length.
B3DGS_HD std::int32_t n_buckets_of(std::int32_t length) {
  return (length + kBucketEntries - 1) / kBucketEntries;
}

/// Buckets: kBucketEntries consecutive entries of a tile's list; a list's last bucket may be shorter. Numbered tile by
/// tile.
struct Buckets {
  const std::int64_t* offsets = nullptr;         // [n_tiles] each tile's first bucket
  const std::int32_t* tile_of_bucket = nullptr;  // [n]
  std::int64_t n = 0;
};

/// The lists of a view, which bin.cu and sort_lists.cu make. Ids of splats are rows of ProjectOutputs, and so are
/// slot_offsets.
struct ListArgs {
  ProjectOutputs projected{};
  std::int64_t n_rows = 0;
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  // Out, of number_lists():
  std::int64_t* tile_offsets = nullptr;     // [n_tiles + 1] where each list begins
  std::int64_t* bucket_offsets = nullptr;   // [n_tiles] each list's first bucket
  std::int32_t* next_entries = nullptr;     // [n_tiles], kCounterStride apart: each list's next free entry
  std::int32_t* first_more_runs = nullptr;  // [n_tiles] number of runs after the first of the lists in front
  std::int32_t* tiles_by_length = nullptr;  // [n_tiles] the longest list first, roughly; short ones last
  // Of bin():
  ViewCounts counts{};
  EntryKey *keys = nullptr, *merged = nullptr;  // [n_pairs] scratch
  std::int32_t* splat_ids = nullptr;            // [n_pairs] out
  std::int32_t* tile_of_bucket = nullptr;       // [n_buckets] out
  std::int64_t* slot_offsets = nullptr;         // [n_rows + 1] out: BinnedSplats; null: no slots are wanted
  std::int64_t* pair_slots = nullptr;           // [n_pairs] out, the same

  BinnedSplats bins() const { return {tile_offsets, splat_ids, pair_slots, slot_offsets, counts.n_pairs}; }
  Buckets buckets() const { return {bucket_offsets, tile_of_bucket, counts.n_buckets}; }
};

/// First part of binning, which needs no counts on the host: where each tile's list begins, and all counts, which it
/// writes to pinned memory. Sets the arrays of `args` that it writes.
void number_lists(ListArgs& args, BinBuffers& buffers, ViewCounts* host_counts, const LaunchContext& context);

/// Second part of binning, given args.counts. Pairs are sorted in `scratch`, which is free afterwards.
void bin(ListArgs& args, bool with_slots, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context);

/// Sorts the list of each tile, written in any order to args.keys, to args.splat_ids; fills args.tile_of_bucket.
void sort_lists(const ListArgs& args, const LaunchContext& context);

/// What the backward pass needs from the forward pass: for each pixel, what each bucket adds to it, up to the
/// bucket of the pixel's last splat. Stored per bucket rather than as a running sum: what is behind a bucket is then a
/// sum of parts. As a difference of two running sums it would lose accuracy where it is small.
struct BucketParts {
  // [n_buckets, pixels of a tile row by row] transmittance behind the bucket (finite, but meaningless if no splat of it
  // was blended); red, green, blue that it adds. Null: no parts are stored.
  float4* color = nullptr;
  float* depth = nullptr;  // same shape: depth that it adds. Null: no gradient with respect to depth follows.
  // Parts of a list that was cut into segments must be multiplied by their segment's front.
  const std::int32_t* first_segment_of_tile = nullptr;  // [n_tiles] -1: not cut. Null: no list is cut.
  const float* segment_fronts = nullptr;                // Segments::fronts
  int segment_buckets_log2 = 0;                         // 2^this buckets are a segment
};

/// A length that no list exceeds.
inline constexpr std::int32_t kAnyLength = std::numeric_limits<std::int32_t>::max();
/// Blocks that blend a segment: one for each half of a tile.
inline constexpr std::int32_t kSegmentBlocks = 2;

/// How `segmented` cuts lists.
struct ListCut {
  static constexpr int kMinLog2 = 7, kMaxLog2 = 9;  // of a segment's entries; the smallest is a bucket
  int entries_log2 = kMinLog2;                      // a segment has 2^this entries, the last of a list maybe fewer
  std::int32_t longest_whole = kAnyLength;          // entries; longer lists are cut. kAnyLength: none, as sub-tile
  bool cuts() const { return longest_whole < kAnyLength; }

  /// Number of segments of a list; 1 if it is not cut.
  B3DGS_HD std::int32_t n_segments(std::int32_t length) const {
    return length > longest_whole ? ((length - 1) >> entries_log2) + 1 : 1;
  }
  /// Upper bound of the number of segments of lists with this many entries together, and index of the first segment
  /// behind them. A list that is cut has more than two segments, so at most 1.5 times its entries divided by a
  /// segment's.
  B3DGS_HD std::int64_t segments_before(std::int64_t entries) const { return 3 * entries >> (entries_log2 + 1); }
};

/// Blocks take the longest list first. If it exceeds a multiprocessor's share of all entries, it roughly ends last.
/// Then lists above a quarter of the share are cut, into segments of at most that, or of a bucket (measured:
/// docs/lab/kernels.md). A cut blends some entries twice, so lists of two segments stay whole.
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

/// One segment of a tile's list; segment 0 may be the whole list.
struct SegmentTask {
  std::int32_t tile, segment;  // number of the segment within the list
};

/// Memory of `segmented`. The segments of a tile have consecutive indices, and there may be unused indices between
/// tiles (ListCut::segments_before()).
struct Segments {
  std::int32_t n_max = 0;                 // n: indices are below it
  std::int32_t n_tasks_max = 0;           // upper bound of the number of tasks
  SegmentTask* tasks = nullptr;           // [n_tasks_max] the second segments of all lists, then the third, ...
  std::int32_t* n_tasks = nullptr;        // [1]
  std::int32_t* n_long = nullptr;         // [1] lists that are at least as long as a segment
  std::int32_t* first_of_tile = nullptr;  // [n_tiles] index of the first segment, -1 if the list is not cut
  std::int32_t* hidden_from = nullptr;    // [n_tiles, kSegmentBlocks] from this index on, segments are hidden
  std::int32_t* is_done = nullptr;        // [n, kSegmentBlocks] 1 as soon as the block has blended the segment
  // All [n, pixels of a tile row by row]; undefined behind the segment in which the pixel finishes:
  // Factor of its bucket parts: transmittance in front, 1 if it was blended again. Null: no parts are stored.
  float* fronts = nullptr;
  float* transmittance = nullptr;  // of the segment alone; as in PixelState, negative if it finishes the pixel
  float4* color_depth = nullptr;   // what it adds to a pixel whose transmittance is 1
  std::int32_t* last = nullptr;    // position in the list of the last splat blended, or -1
};

struct BlendForwardCudaArgs {
  BlendForwardArgs blend{};
  Buckets buckets{};
  const std::int32_t* tiles_by_length = nullptr;  // [n_tiles] a permutation; ListArgs
  ListCut cut{};                                  // for `segmented`
  BucketParts parts{};
  Segments segments{};
};

void count_load(const CountLoadArgs& args, const LaunchContext& context);

/// Scoring into args.sums, by row, which must be zero. Without `wants_weights`, sums of weights stay 0.
void score(const ScoreArgs& args, const std::int32_t* tiles_by_length, bool wants_weights,
           const LaunchContext& context);
/// Rows whose radius is 0 are left out. `radii` null: there are none.
void add_scores(const AddScoresArgs& args, const std::int32_t* radii, const LaunchContext& context);

struct BlendBackwardCudaArgs {
  BlendBackwardArgs blend{};  // its pair_grads are not used
  Buckets buckets{};
  BucketParts parts{};
  SplatGradSum* splat_grads = nullptr;  // [rows] in and out: added to, must be zero where there is a splat
  // Scratch of per-bucket, [n_buckets, pixels of a tile row by row]: what is behind each bucket of a list that is not
  // short (kShortListEntries), as `behind` of ReverseState. Null: per-pixel, or not has_many_parts().
  float* behind = nullptr;
  const std::int32_t* tiles_by_length = nullptr;  // ListArgs; with `behind`
  std::int32_t n_long_lists = 0;                  // with `behind`; ViewCounts
  // [n_pairs] by slot, must be zero. Null: gradients are added to splat_grads with atomics, in an order that changes
  // from run to run, as per-pixel always does.
  SplatGradSum* pair_grads = nullptr;
};

/// Sums each splat's pair gradients in a fixed order, so that repeated runs give the same bits. `slot_offsets`
/// [n_rows + 1], `pair_grads` [n_pairs] by slot, `sums` [n_rows] out.
void sum_splat_grads(std::int64_t n_rows, const std::int64_t* slot_offsets, const SplatGradSum* pair_grads,
                     SplatGradSum* sums, const LaunchContext& context);

/// Of a panorama: adds the sums of row N + i to those of row i. `radii` and `sums` [2 N].
template <class Sums>
void join_second(std::int64_t n_gaussians, const std::int32_t* radii, Sums* sums, const LaunchContext& context);

/// For RenderSettings::inverse_depth (math/project_splat.h): after binning, and after the backward blend. All arrays
/// [n_rows]; rows of radius 0 have no splat.
void invert_depths(std::int64_t n_rows, const std::int32_t* radii, Splat* splats, const LaunchContext& context);
void invert_depth_gradients(std::int64_t n_rows, const std::int32_t* radii, const Splat* splats, SplatGradSum* sums,
                            const LaunchContext& context);

struct ProjectBackwardCudaArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  const std::int32_t* radii = nullptr;        // [N] 0 if not seen
  const Splat* splats = nullptr;              // [N]
  const SplatGradSum* splat_grads = nullptr;  // [N]
  GaussianGradArrays grad{};
  bool antialiasing = false;
};
void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context);

/// In place of project_backward(): keeps the splats' sums for a later one. `n_records` [1] scratch.
void keep_splat_records(const ProjectBackwardCudaArgs& args, std::int32_t* n_records, const SplatRecordArrays& out,
                        const LaunchContext& context);

/// The same for splats rendered elsewhere.
void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context);

/// Gradient with respect to the camera's pose (math/gaussian_grad.h).
struct CameraGradientArgs {
  ProjectBackwardCudaArgs backward{};  // its `grad` is not used
  // [M] rows of the splats, of which second splats are left out: their sums are in the first; null: all M rows.
  const std::int32_t* seen = nullptr;
  std::int64_t n_splats = 0;     // M
  double* parts = nullptr;       // [kCameraGradientParts, kCameraGradients] scratch, a sum per block
  double* out = nullptr;         // [kCameraGradients] out
  float* splat_parts = nullptr;  // [M, kCameraGradients] out: what each splat adds; null: not wanted
};
inline constexpr int kCameraGradientParts = 1024;
void camera_gradient(const CameraGradientArgs& args, const LaunchContext& context);

/// The sum over splats, in their order, as camera_gradient() adds them. `parts` and `out` as there.
void sum_camera_parts(const float* splat_parts, std::int64_t n_splats, double* parts, double* out,
                      const LaunchContext& context);

}  // namespace b3dgs::cuda
