// The CUDA rasterizer, and its passes and their arguments. Each pass is queued on context.stream and does not wait for
// the device. rasterize_cuda.cpp calls them.
#pragma once

#include <functional>
#include <memory>

#include "raster/args.h"
#include "raster/cuda/device_buffer.h"
#include "raster/rasterizer_backend.h"
#include "raster/splat_rows.h"

namespace b3dgs::cuda {

/// A rasterizer that calls `context` for the stream and the memory of each pass.
std::unique_ptr<RasterizerBackend> make_rasterizer(std::function<LaunchContext()> context);

/// Totals of one view; the host reads them once per forward pass.
struct ViewCounts {
  std::int64_t n_splats;       // M
  std::int64_t n_pairs;        // (tile, splat) pairs
  std::int64_t first_invalid;  // smallest index of an invalid Gaussian, n_gaussians if there is none
};

/// Outputs of projection, a row per Gaussian.
struct ProjectOutputs {
  Splat* splats = nullptr;          // [N] written only for seen Gaussians
  Vec2f* extents = nullptr;         // [N] written only for seen Gaussians
  std::int32_t* radii = nullptr;    // [N] 0 if not seen
  std::int32_t* n_tiles = nullptr;  // [N] tiles touched, 0 if not seen
  // [N] bit pattern of the depth, 0 if not seen. Positive floats compare like their bit patterns.
  std::uint32_t* depth_bits = nullptr;
  ViewCounts* counts = nullptr;  // [1]
};

/// Arguments of a ColorPass.
struct ColorCudaArgs {
  GaussianArrays gaussians{};
  Vec3f camera_center{};  // world space
  int sh_degree = 0;
  // To be written: red, green, blue and clamped of each seen splat, and counts->first_invalid (note_invalid()).
  ProjectOutputs projected{};
};

/// Computes the splats' colours instead of project(). Lets training update SH coefficients of seen Gaussians in the
/// same kernel that reads them.
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
  bool with_colors = true;  // false: a ColorPass follows
  bool antialiasing = false;
};
void project(const ProjectCudaArgs& args, const LaunchContext& context);

/// Counts of a view without splats. project() and load_rows() begin with it.
void reset_counts(ViewCounts* counts, std::int64_t n_gaussians, const LaunchContext& context);

/// After list_seen(): the rows of the Gaussians that the view sees.
struct CopySeenArgs {
  ProjectOutputs projected{};
  const std::int32_t* seen = nullptr;  // [M]
  std::int64_t n_splats = 0;           // M, or room for as many if the number is on the device
  SplatRowArrays out{};                // [n_splats]
  const ViewCounts* counts = nullptr;  // whose n_splats is M; null: the host knows it
};
void copy_seen(const CopySeenArgs& args, const LaunchContext& context);

/// In place of project(): splats that were projected elsewhere. They are numbered as Gaussians, row by row.
struct LoadRowsArgs {
  SplatRows rows{};
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  ProjectOutputs out{};
};
void load_rows(const LoadRowsArgs& args, const LaunchContext& context);

/// Buffers of binning, reused from view to view.
struct BinBuffers {
  DeviceBuffer<std::uint32_t> depths, depths_sorted;
  DeviceBuffer<std::int32_t> seen, seen_by_depth, splat_of_gaussian, splat_ids, tile_of_bucket;
  DeviceBuffer<std::int64_t> slot_offsets, pair_slots, tile_offsets, bucket_offsets;
  DeviceBuffer<unsigned long long> n_buckets;
  DeviceBuffer<Splat> splats;
  DeviceBuffer<Vec2f> extents;
  DeviceBuffer<unsigned char> temporary;  // of CUB's algorithms over Gaussians

  template <class Visit>
  void visit_buffers(Visit&& visit) {
    visit(depths), visit(depths_sorted), visit(seen), visit(seen_by_depth), visit(splat_of_gaussian);
    visit(splat_ids), visit(tile_of_bucket), visit(slot_offsets), visit(pair_slots), visit(tile_offsets);
    visit(bucket_offsets), visit(n_buckets), visit(splats), visit(extents), visit(temporary);
  }
};

struct BinCudaArgs {
  ProjectOutputs projected{};
  std::int64_t n_gaussians = 0, n_splats = 0, n_pairs = 0;
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  bool keep_slots = false;  // fill pair_slots
};

/// Entries of a bucket: the blocks of the backward pass, and what the forward pass stores its parts for. Fewer mean
/// more parts to write and read; more, less even shares.
inline constexpr std::int32_t kBucketEntries = 128;

/// Buckets: runs of kBucketEntries entries of a tile's list; a list's last bucket may be shorter. The buckets of a tile
/// have consecutive numbers; the order of the tiles is arbitrary.
struct Buckets {
  const std::int64_t* offsets = nullptr;         // [n_tiles] each tile's first bucket
  const std::int32_t* tile_of_bucket = nullptr;  // [n]
  const unsigned long long* n = nullptr;         // [1] number of buckets
  std::int64_t n_max = 0;                        // upper bound of n, known to the host
};

/// Result of binning: splats in depth order, and a list per tile.
struct BinnedView {
  const Splat* splats = nullptr;                    // [M] nearest first; equal depths in the order of the Gaussians
  const Vec2f* extents = nullptr;                   // [M]
  const std::int32_t* splat_of_gaussian = nullptr;  // [N] index in `splats`; undefined if not seen
  BinnedSplats bins{};                              // pair_slots is null unless keep_slots
  Buckets buckets{};
};

/// First part of binning, which needs no counts on the host: writes indices and depths of the seen Gaussians to
/// buffers.seen and buffers.depths.
void list_seen(const ProjectOutputs& projected, std::int64_t n_gaussians, BinBuffers& buffers,
               const LaunchContext& context);

/// Second part of binning, after list_seen(). Pairs are sorted in `scratch`; the result does not use it.
BinnedView bin(const BinCudaArgs& args, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context);

/// For a pixel and a segment of its list: the transmittance in front of the segment, by which the segment's bucket
/// parts are to be multiplied. A pixel whose list has four segments and which finishes in the third:
///
///     segment                 0           1           2            3
///     transmittance      1 ------> 0.5 -----> 0.01 -----> finished
///     forward_segmented                   1           1            1    its parts begin at transmittance 1
///     join_segments           1          0.5       -0.01           1    -: to be blended again from 0.01
///     end_pixels              1          0.5          1            1    that was done: its parts are now absolute
struct SegmentFront {
  float value;
  static B3DGS_HD SegmentFront blend_again_from(float transmittance) { return {-transmittance}; }
  B3DGS_HD bool is_to_blend_again() const { return value < 0; }
  B3DGS_HD float transmittance_to_blend_from() const { return -value; }
};

/// What the backward pass needs from the forward pass: for each pixel, what each bucket adds to it, up to the
/// bucket of the pixel's last splat. Stored per bucket rather than as a running sum: what is behind a bucket is then a
/// sum of parts. As a difference of two running sums it would lose accuracy where it is small.
struct BucketParts {
  // [n_buckets, pixels of a tile row by row] transmittance behind the bucket (finite, but meaningless if no splat of it
  // was blended); red, green, blue that it adds. Null: no parts are stored.
  float4* color = nullptr;
  float* depth = nullptr;  // same shape: depth that it adds. Null: no gradient with respect to depth follows.
  // Parts of a list that was cut into segments must be multiplied by the transmittance in front of the segment.
  const std::int32_t* first_segment_of_tile = nullptr;  // [n_tiles] -1: not cut. Null: no list is cut.
  const SegmentFront* segment_fronts = nullptr;         // Segments::fronts
};

/// `segmented` cuts longer lists into segments of this many entries, a multiple of the bucket size.
inline constexpr std::int32_t kSegmentEntries = 1024;

/// One segment of a tile's list; segment 0 may be the whole list.
struct SegmentTask {
  std::int32_t tile, segment;  // number of the segment within the list
};

/// Scratch memory of `segmented`. The segments of a tile have consecutive indices, and there may be unused indices
/// between tiles. A list longer than a segment is cut into at most 2 entries / kSegmentEntries segments, so indices are
/// below n = 2 n_pairs / kSegmentEntries.
struct Segments {
  std::int32_t n_tasks_max = 0;           // upper bound of the number of tasks, known to the host
  SegmentTask* tasks = nullptr;           // [n_tasks_max] the second segments of all lists, then the third, ...
  std::int32_t* n_tasks = nullptr;        // [1]
  std::int32_t* first_of_tile = nullptr;  // [n_tiles] index of the first segment, -1 if the list is not cut
  std::int32_t* is_done = nullptr;        // [n] 1 as soon as the segment is blended
  // All [n, pixels of a tile row by row]:
  SegmentFront* fronts = nullptr;
  float* transmittance = nullptr;  // of the segment alone; as in PixelState, negative if it finishes the pixel
  // What it adds to a pixel whose transmittance is 1; position in the list of the last splat blended, or -1. If the
  // segment is to be blended again: colour, depth and last splat in front of it.
  float4* color_depth = nullptr;
  std::int32_t* last = nullptr;
};

struct BlendForwardCudaArgs {
  BlendForwardArgs blend{};
  Buckets buckets{};
  BucketParts parts{};
  std::int32_t* next_task = nullptr;  // [1] task counter, 0 at the start
  // Scratch of `combined`: for each tile: [quads, runs of 32 entries]
  std::uint32_t* quad_masks = nullptr;
  Segments segments{};
};

void count_load(const CountLoadArgs& args, const LaunchContext& context);

/// Scoring into args.sums, [M] by splat, which must be zero.
void score(const ScoreArgs& args, const LaunchContext& context);
void add_scores(const AddScoresArgs& args, const LaunchContext& context);

struct BlendBackwardCudaArgs {
  BlendBackwardArgs blend{};  // its pair_grads are not used
  Buckets buckets{};
  BucketParts parts{};
  SplatGradSum* splat_grads = nullptr;  // [M] in and out: added to, must be zero
  // [n_pairs] by slot, must be zero. Null: gradients are added to splat_grads with atomics, in an order that changes
  // from run to run. Only the per-bucket kernel supports it.
  SplatGradSum* pair_grads = nullptr;
};

/// Sums each splat's pair gradients in a fixed order, so that repeated runs give the same bits.
struct SumSplatGradsArgs {
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGradSum* pair_grads = nullptr;    // [n_pairs] by slot
  SplatGradSum* splat_grads = nullptr;         // [M] out
};
void sum_splat_grads(const SumSplatGradsArgs& args, const LaunchContext& context);

/// For RenderSettings::inverse_depth (math/project_splat.h): after binning, and after the backward blend.
void invert_depths(Splat* splats, std::int64_t n_splats, const LaunchContext& context);
void invert_depth_gradients(const Splat* splats, std::int64_t n_splats, SplatGradSum* splat_grads,
                            const LaunchContext& context);

struct ProjectBackwardCudaArgs {
  GaussianArrays gaussians{};
  PinholeView view{};
  int sh_degree = 0;
  const std::int32_t* radii = nullptr;              // [N] 0 if not seen
  const std::int32_t* splat_of_gaussian = nullptr;  // [N]
  const Splat* splats = nullptr;                    // [M]
  const SplatGradSum* splat_grads = nullptr;        // [M]
  GaussianGradArrays grad{};
  bool antialiasing = false;
};
void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context);

/// Keeps the splats' sums for a later backward projection.
struct SplatRecordArgs {
  std::int64_t n_gaussians = 0;
  const std::int32_t* radii = nullptr;              // [N] 0 if not seen
  const std::int32_t* splat_of_gaussian = nullptr;  // [N]
  const Splat* splats = nullptr;                    // [M]
  const SplatGradSum* splat_grads = nullptr;        // [M]
  SplatRecordArrays out{};
};
void keep_splat_records(const SplatRecordArgs& args, const LaunchContext& context);

/// The same for splats that were drawn elsewhere.
void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context);

/// The splats of load_rows().
struct SplatsOfRows {
  std::int64_t n_rows = 0;
  const std::int32_t* radii = nullptr;         // [n_rows] 0 if not drawn
  const std::int32_t* splat_of_row = nullptr;  // [n_rows]
};

/// From the order of the splats to that of the rows; 0 for a row that is not drawn.
void rows_of_splats(const SplatsOfRows& splats, const SplatGradSum* by_splat, SplatGradSum* by_row,
                    const LaunchContext& context);
void rows_of_splats(const SplatsOfRows& splats, const ScoreSums* by_splat, ScoreSums* by_row,
                    const LaunchContext& context);

/// Gradient with respect to the camera's pose (math/gaussian_grad.h).
struct CameraGradientArgs {
  ProjectBackwardCudaArgs backward{};  // its `grad` is not used
  std::int64_t n_splats = 0;           // M
  double* parts = nullptr;             // [kCameraGradientParts, kCameraGradients] scratch, a sum per block
  double* out = nullptr;               // [kCameraGradients] out
  float* splat_parts = nullptr;        // [M, kCameraGradients] out: what each splat adds; null: not wanted
};
inline constexpr int kCameraGradientParts = 1024;
void camera_gradient(const CameraGradientArgs& args, const LaunchContext& context);

/// The sum over splats, in their order, as camera_gradient() adds them. `parts` and `out` as there.
void sum_camera_parts(const float* splat_parts, std::int64_t n_splats, double* parts, double* out,
                      const LaunchContext& context);

}  // namespace b3dgs::cuda
