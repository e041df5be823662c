// Inputs and outputs of the rasterizer and of its passes; those of projection and binning, which differ by device, are
// in cpu/passes.h and cuda/passes.h. The structs hold pointers and sizes only; the caller owns the memory, which is
// contiguous and on one device. Shapes are given beside the pointers: N Gaussians, M splats (Gaussians seen in the
// view), K = (sh_degree_max + 1)^2 SH coefficients per channel, H x W pixels.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "core/vec.h"
#include "raster/constants.h"
#include "raster/kernels.h"
#include "raster/stages.h"
#include "raster/view_lens.h"

namespace b3dgs {

namespace cuda {
class ColorPass;  // cuda/passes.h
}

/// One pinhole view. Camera frame: +x right, +y down, +z forward; the centre of pixel (i, j) is (i + 0.5, j + 0.5).
struct PinholeView {
  Mat3f rotation;              // world to camera: x_camera = rotation x_world + translation
  Vec3f translation;           // world units
  Vec3f center;                // camera centre in world space
  float fx, fy, cx, cy;        // px
  std::int32_t width, height;  // px
};

/// One view, of any lens.
struct CameraView : PinholeView {
  CameraView() = default;
  CameraView(const PinholeView& pinhole, const ViewLens& with = {}) : PinholeView(pinhole), lens(with) {}
  ViewLens lens{};
};

/// Parameters of all Gaussians as stored, before activation.
struct GaussianArrays {
  std::int64_t n_gaussians = 0;
  int sh_degree_max = 0;                   // degree that shN is allocated for
  const float* means = nullptr;            // [N, 3] world space
  const float* log_scales = nullptr;       // [N, 3]
  const float* quats = nullptr;            // [N, 4] w x y z, of any length except 0
  const float* logit_opacities = nullptr;  // [N]
  const float* sh0 = nullptr;              // [N, 3]
  const float* shN = nullptr;              // [N, K-1, 3]
  // [N] world units, standard deviation of the 3D smoothing filter (antialiasing.h); used with antialiasing only. Null:
  // no 3D filter.
  const float* filters = nullptr;
};

/// Gradients of the loss with respect to the stored parameters. Every row is written; rows of Gaussians that the view
/// does not see are zero.
struct GaussianGradArrays {
  float* means = nullptr;            // [N, 3]
  float* log_scales = nullptr;       // [N, 3]
  float* quats = nullptr;            // [N, 4]
  float* logit_opacities = nullptr;  // [N]
  float* sh0 = nullptr;              // [N, 3]
  float* shN = nullptr;              // [N, K-1, 3]; coefficients above the rendered degree get 0
  float* means2d = nullptr;          // [N, 2] of the projected centre, in 1/px
};

enum class Culling {
  kEllipse,  // tiles touched by the ellipse within which alpha >= 1/255: shorter lists, without changing the image
  kSquare,   // all tiles of the 3-sigma square, as in the original rasterizer: cuts off the tails of opaque splats
};

/// Runs the forward blend of a view: calls blend(kernel) once or, to time several kernels of the family, more often.
/// The last call leaves the image and what the backward pass needs.
using BlendRunner = std::function<void(const std::function<void(ForwardKernel)>& blend)>;

struct RenderSettings {
  Vec3f background{0, 0, 0};      // RGB, multiplied by the final transmittance
  int sh_degree = 0;              // degree to render, at most sh_degree_max
  float near_plane = kNearPlane;  // world units; Gaussians of a smaller depth are culled
  Culling culling = Culling::kEllipse;
  std::optional<TileShape> tile{};  // on the CPU, for tests: other tiles than those of the kernel's family
  ForwardKernel kernel = kStandardKernel;
  // On CUDA: sum gradients in a fixed order, which the paper's family cannot; the CPU always does.
  bool deterministic = false;
  bool antialiasing = false;               // see antialiasing.h
  bool keep_for_backward = true;           // false saves memory and time if backward() will not be called
  bool depth_gradient = true;              // false saves GPU memory if no gradient with respect to depth follows
  bool inverse_depth = false;              // the depth image is the sum of weight over depth, 1 / world units
  bool camera_gradient = false;            // backward() also computes the gradient with respect to the camera's pose
  StageRecorder* stages = nullptr;         // notified when a stage begins; may be null
  const BlendRunner* run_blend = nullptr;  // null: `kernel`, once
  cuda::ColorPass* color_pass = nullptr;   // on CUDA: computes the splats' colours; null: the projection does

  TileShape tile_shape() const { return tile.value_or(tile_of(family_of(kernel))); }
};

/// Numbers of a gradient with respect to the camera's pose (math/gaussian_grad.h): rotation, then translation.
inline constexpr int kCameraGradients = 6;

/// The rendered view.
struct ImageArrays {
  float* color = nullptr;  // [H, W, 3] RGB, not clamped
  float* depth = nullptr;  // [H, W] sum of weight times depth (world units), not divided by alpha; or
                           // RenderSettings::inverse_depth
  float* alpha = nullptr;  // [H, W] 1 - final transmittance
};

/// Gradients of the loss with respect to the rendered view. Null means zero.
struct ImageGradArrays {
  const float* color = nullptr;  // [H, W, 3]
  const float* depth = nullptr;  // [H, W]
  const float* alpha = nullptr;  // [H, W]
};

/// A Gaussian projected into one view: 48 bytes, three 16-byte loads. The exponent is in base 2 and includes the
/// opacity: alpha = exp2(log2_opacity - d^T conic d) with d = pixel centre - mean.
struct alignas(16) Splat {
  float mean_x, mean_y;                // px
  float log2_opacity;                  // <= 0
  float depth;                         // world units: camera-space z, or distance (has_radial_depth())
  float conic_xx, conic_xy, conic_yy;  // inverse 2D covariance (1/px^2), times kConicScale
  std::int32_t gaussian;               // index of the Gaussian, < N
  float red, green, blue;              // clamped at 0
  std::uint32_t clamped;               // bit c: channel c was clamped and has no gradient
};
static_assert(sizeof(Splat) == 48, "three 16-byte loads");

/// Gradient of the loss with respect to a splat, summed over pixels by the backward blend; gaussian_grad.h turns it
/// into parameter gradients. With g = dL/d(ln alpha) and p = conic delta at a pixel (Footprint in blend.h), the sums
/// for mean and covariance are those of g p and g p p^T: multiples of the gradients (projection.h). p rather than
/// delta, because along a needle delta is long and p short, and multiplying by the conic after summing would cancel the
/// digits.
struct SplatGrad {
  float log_alpha;               // g
  float mean_x, mean_y;          // g p: dL/dmean times kConicScale
  float cov_xx, cov_xy, cov_yy;  // g p p^T: dL/dcov times 2 kConicScale^2
  float red, green, blue;
  float depth;
};

/// Tiles of an image, numbered row by row.
struct TileGrid {
  std::int32_t image_width = 0, image_height = 0;  // px
  TileShape tile{};
  std::int32_t columns = 0, rows = 0;
  B3DGS_HD std::int32_t n_tiles() const { return columns * rows; }
};

/// Result of binning: the (tile, splat) pairs, sorted by tile and then by depth. Each pair also has a slot. The slots
/// of one splat are contiguous, so that gradients written to slots can be summed per splat in a fixed order. On CUDA,
/// the id of a splat is its row in cuda::ProjectOutputs, and M is the number of rows.
struct BinnedSplats {
  const std::int64_t* tile_offsets = nullptr;  // [n_tiles + 1] start of each tile's list in splat_ids
  const std::int32_t* splat_ids = nullptr;     // [n_pairs] in [0, M), nearest first within a tile
  const std::int64_t* pair_slots = nullptr;    // [n_pairs] slot of each pair
  const std::int64_t* slot_offsets = nullptr;  // [M + 1] first slot of each splat
  std::int64_t n_pairs = 0;
};

/// What all blending passes read.
struct TileLists {
  const Splat* splats = nullptr;   // [M]
  const Vec2f* extents = nullptr;  // [M] half size of the box around alpha >= 1/255, px
  BinnedSplats bins{};
  TileGrid grid{};
};

/// Forward blend: lists of splats to pixels.
struct BlendForwardArgs : TileLists {
  Vec3f background{};
  ImageArrays out{};
  float* transmittance = nullptr;    // [H, W] out: final transmittance, more exact than 1 - alpha
  std::int32_t* last_ids = nullptr;  // [H, W] out: position in the tile's list of the last splat blended, -1 if none
};

/// Backward blend, given the outputs of the forward blend: from gradients with respect to pixels to those with respect
/// to splats, one SplatGrad per (tile, splat) pair.
struct BlendBackwardArgs : BlendForwardArgs {
  ImageGradArrays grad{};
  SplatGrad* pair_grads = nullptr;  // [n_pairs] out, by slot; every one is written
};

/// Load counting: how many entries of its tile's list each pixel evaluates up to the one that finishes it, and how many
/// it blends. The same for every kernel: entries that a schedule evaluates beyond the end are not counted.
struct CountLoadArgs : TileLists {
  std::int32_t* processed = nullptr;     // [H, W] out: entries evaluated
  std::int32_t* contributing = nullptr;  // [H, W] out: entries blended
};

/// Sums over the pixels of a view, and what they are added to. Fixed point, so that a sum does not depend on the order
/// of its terms: units of 2^-24 (math/pixel_outputs.h), which 64 bits hold for 2^40 pixels.
struct ScoreSums {
  std::uint64_t error, weight;
  float max_weight;
  std::uint32_t unused = 0;  // ranks exchange all bytes
};

/// Scoring: sums of weights and of weighted errors. The blend's own arithmetic, entry by entry in list order, so that
/// the result does not depend on the forward kernel.
struct ScoreArgs : TileLists {
  const float* error = nullptr;  // [H, W] values outside [0, 1] count as the nearer limit, NaN as 0
  ScoreSums* sums = nullptr;     // CPU: [n_pairs] out, by slot; every one is written. CUDA: [M] in and out, added to
};

/// What the pixels of a view say about the Gaussians that it sees. All [N], in and out; other Gaussians' entries stay.
/// The weight of a Gaussian in a pixel is alpha times the transmittance in front of it, as in blending.
struct ScoreArrays {
  float* error_sum = nullptr;   // plus the sum over pixels of weight times error
  float* weight_sum = nullptr;  // plus the sum of weights, px; null: not wanted
  float* max_weight = nullptr;  // the larger of it and the largest weight in a pixel
  float* n_views = nullptr;     // plus 1
};

/// Adds the sums of each splat to the entries of its Gaussian.
struct AddScoresArgs {
  const Splat* splats = nullptr;  // [M]
  std::int64_t n_splats = 0;
  const ScoreSums* sums = nullptr;  // [M]
  ScoreArrays out{};
};

// Views whose splats one rasterizer projects, to rows of an array, and another renders. A Gaussian across the seam of a
// panorama also has a single row, that of its first splat (math/project_splat.h): the renderer makes the second, and
// adds its sums to those of the first.

/// Numbers of splats of a view.
struct SplatCounts {
  std::int64_t n_first = 0;   // of Gaussians that the view sees
  std::int64_t n_second = 0;  // of those that a panorama draws twice
};

/// M splats. Of two at the same depth, the earlier one is in front.
struct SplatRows {
  std::int64_t n_splats = 0;            // M
  const Splat* splats = nullptr;        // [M]
  const Vec2f* extents = nullptr;       // [M] as TileLists::extents
  const std::int32_t* radii = nullptr;  // [M] 3 standard deviations in px, rounded up
};

/// Memory for SplatRows.
struct SplatRowArrays {
  Splat* splats = nullptr;
  Vec2f* extents = nullptr;
  std::int32_t* radii = nullptr;
};

/// Returns memory for M splats.
using SplatAllocator = std::function<SplatRowArrays(std::int64_t n_splats)>;

// Backward projections that follow later, after other views or on the rank that owns the Gaussians.

/// Sums of one splat, with all that turns them into the gradient of its Gaussian.
struct alignas(16) SplatRecord {
  SplatGrad sum;
  std::int32_t gaussian;  // < N
  std::uint32_t clamped;  // as in Splat
};
static_assert(sizeof(SplatRecord) == 48, "three 16-byte words");

/// Of one view with N Gaussians and M splats.
struct SplatRecordArrays {
  SplatRecord* records = nullptr;              // [M] out, in any order
  std::int32_t* record_of_gaussian = nullptr;  // [N] out: index in `records`; -1 if the view does not see the Gaussian
  float* means2d = nullptr;                    // [N, 2] out: gradient of the projected centre, 1/px; 0 if not seen
};

/// A splat's sums of the backward blend, in three 16-byte words for vector atomics.
struct alignas(16) SplatGradSum {
  SplatGrad sum;
  float unused[2];  // 0
};
static_assert(sizeof(SplatGradSum) == 48, "three 16-byte words");

/// Keeps sums of splats rendered elsewhere, for a later backward projection.
struct KeepSplatsArgs {
  std::int64_t n_gaussians = 0;               // N
  SplatRows rows{};                           // as projected: Splat::gaussian < N, each at most once
  const SplatGradSum* splat_grads = nullptr;  // [M]
  SplatRecordArrays out{};                    // record m is that of row m
  std::int32_t* radii = nullptr;              // [N] out: 0 if not seen
};

}  // namespace b3dgs
