// Inputs and outputs of the rasterizer and of each of its passes. The structs hold pointers and sizes only; the caller
// owns the memory, which is contiguous and on one device. Shapes are given beside the pointers: N Gaussians, M splats
// (Gaussians seen in the view), K = (sh_degree_max + 1)^2 SH coefficients per channel, H x W pixels.
#pragma once

#include <cstdint>

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

/// Size of a tile, px.
struct TileShape {
  std::int32_t width = 16, height = 16;
};

struct RenderSettings {
  Vec3f background{0, 0, 0};      // RGB, multiplied by the final transmittance
  int sh_degree = 0;              // degree to render, at most sh_degree_max
  float near_plane = kNearPlane;  // world units; Gaussians of a smaller depth are culled
  Culling culling = Culling::kEllipse;
  TileShape tile{};
  ForwardKernel kernel = ForwardKernel::kSharedMemory;
  BackwardKernel backward_kernel = BackwardKernel::kPerBucket;  // on CUDA
  bool deterministic = false;             // on CUDA: sum gradients in a fixed order; the CPU always does
  bool antialiasing = false;              // see antialiasing.h
  bool keep_for_backward = true;          // false saves memory and time if backward() will not be called
  bool depth_gradient = true;             // false saves GPU memory if no gradient with respect to depth follows
  bool inverse_depth = false;             // the depth image is the sum of weight over camera-space z, 1 / world units
  bool camera_gradient = false;           // backward() also computes the gradient with respect to the camera's pose
  StageRecorder* stages = nullptr;        // notified when a stage begins; may be null
  cuda::ColorPass* color_pass = nullptr;  // on CUDA: computes the splats' colours; null: the projection does
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

/// Projection: Gaussians to the splats of one view, in the order of the Gaussians (CPU).
struct ProjectArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  float near_plane = kNearPlane;  // world units
  Culling culling = Culling::kEllipse;
  TileGrid grid{};
  // [N] out, or [2 N] for a panorama, whose splats across the seam follow those of their Gaussians; the first M are
  // written.
  Splat* splats = nullptr;
  Vec2f* extents = nullptr;       // the same: half size of the box around alpha >= 1/255, px
  std::int32_t* radii = nullptr;  // [N] out: 3 standard deviations in px, rounded up; 0 if the Gaussian is not seen
  bool antialiasing = false;
  bool is_drawn = true;  // false: splats across the seam are counted, not written
};

/// Binning: splats to a list per tile, nearest first; equal depths in the order of the Gaussians (CPU).
struct BinArgs {
  const Splat* splats = nullptr;
  const Vec2f* extents = nullptr;
  const std::int32_t* radii = nullptr;  // [N]
  std::int64_t n_splats = 0;            // M
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
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

/// Forward blend: lists of splats to pixels.
struct BlendForwardArgs {
  const Splat* splats = nullptr;   // [M]
  const Vec2f* extents = nullptr;  // [M]
  BinnedSplats bins{};
  TileGrid grid{};
  Vec3f background{};
  ImageArrays out{};
  float* transmittance = nullptr;    // [H, W] out: final transmittance, more exact than 1 - alpha
  std::int32_t* last_ids = nullptr;  // [H, W] out: position in the tile's list of the last splat blended, -1 if none
};

/// Load counting: how many entries of its tile's list each pixel evaluates up to the one that finishes it, and how many
/// it blends. The same for every kernel: entries that a schedule evaluates beyond the end are not counted.
struct CountLoadArgs {
  const Splat* splats = nullptr;  // [M]
  BinnedSplats bins{};
  TileGrid grid{};
  std::int32_t* processed = nullptr;     // [H, W] out: entries evaluated
  std::int32_t* contributing = nullptr;  // [H, W] out: entries blended
};

/// Backward blend: from gradients with respect to pixels to those with respect to splats, one SplatGrad per (tile,
/// splat) pair.
struct BlendBackwardArgs {
  const Splat* splats = nullptr;
  const Vec2f* extents = nullptr;
  BinnedSplats bins{};
  TileGrid grid{};
  Vec3f background{};
  // Outputs of the forward pass:
  ImageArrays rendered{};
  const float* transmittance = nullptr;    // [H, W]
  const std::int32_t* last_ids = nullptr;  // [H, W]
  ImageGradArrays grad{};
  SplatGrad* pair_grads = nullptr;  // [n_pairs] out, by slot; every one is written
};

/// Sums over the pixels of a view, and what they are added to. Fixed point, so that a sum does not depend on the order
/// of its terms: units of 2^-24 (math/pixel_outputs.h), which 64 bits hold for 2^40 pixels.
struct ScoreSums {
  std::uint64_t error, weight;
  float max_weight;
};

/// What the pixels of a view say about the Gaussians that it sees. All [N]; other Gaussians' entries stay. The weight
/// of a Gaussian in a pixel is alpha times the transmittance in front of it, as in blending.
struct ScoreArrays {
  float* error_sum = nullptr;   // in and out: plus the sum over pixels of weight times error
  float* weight_sum = nullptr;  // in and out: plus the sum of weights, px; null: not wanted
  float* max_weight = nullptr;  // in and out: the larger of it and the largest weight in a pixel
  float* n_views = nullptr;     // in and out: plus 1
};

/// Scoring: sums of weights and of weighted errors. The blend's own arithmetic, entry by entry in list order, so that
/// the result does not depend on the forward kernel.
struct ScoreArgs {
  const Splat* splats = nullptr;   // [M]
  const Vec2f* extents = nullptr;  // [M]
  BinnedSplats bins{};
  TileGrid grid{};
  const float* error = nullptr;  // [H, W] values outside [0, 1] count as the nearer limit, NaN as 0
  ScoreSums* sums = nullptr;     // CPU: [n_pairs] out, by slot; every one is written. CUDA: [M] in and out, added to
};

/// Adds the sums of each splat to the entries of its Gaussian.
struct AddScoresArgs {
  const Splat* splats = nullptr;  // [M]
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1] CPU only; null: sums are [M]
  const ScoreSums* sums = nullptr;             // CPU: [n_pairs] by slot, see above. CUDA: [n_splats]
  ScoreArrays out{};
};

/// Backward projection: from gradients with respect to splats to those with respect to the stored parameters (CPU).
struct ProjectBackwardArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  const Splat* splats = nullptr;  // [M]
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGrad* pair_grads = nullptr;       // [n_pairs] by slot
  GaussianGradArrays grad{};
  bool antialiasing = false;
};

}  // namespace b3dgs
