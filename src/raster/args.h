// Inputs and outputs of the rasterizer and its passes. Those of projection and binning differ by device and are in
// cpu/passes.h and cuda/passes.h. The structs hold only pointers and sizes. The caller owns the memory, which is
// contiguous and on one device. Comments beside the pointers give the shapes: N Gaussians, M splats (Gaussians that are
// visible in the view), K = (sh_degree_max + 1)^2 SH coefficients per channel, H x W pixels.
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

/// A pinhole view. Camera frame: +x right, +y down, +z forward. The centre of pixel (i, j) is (i + 0.5, j + 0.5).
struct PinholeView {
  Mat3f rotation;              // world to camera: x_camera = rotation x_world + translation
  Vec3f translation;           // world units
  Vec3f center;                // camera centre in world space
  float fx, fy, cx, cy;        // px
  std::int32_t width, height;  // px
};

/// A view with any lens.
struct CameraView : PinholeView {
  CameraView() = default;
  CameraView(const PinholeView& pinhole, const ViewLens& with = {}) : PinholeView(pinhole), lens(with) {}
  ViewLens lens{};
};

/// Parameters of all Gaussians as stored, before activation.
struct GaussianArrays {
  std::int64_t n_gaussians = 0;
  int sh_degree_max = 0;                   // degree for which shN is allocated
  const float* means = nullptr;            // [N, 3] world space
  const float* log_scales = nullptr;       // [N, 3]
  const float* quats = nullptr;            // [N, 4] w x y z, any length except 0
  const float* logit_opacities = nullptr;  // [N]
  const float* sh0 = nullptr;              // [N, 3]
  const float* shN = nullptr;              // [N, K-1, 3]
  // [N] Standard deviation of the 3D smoothing filter in world units (antialiasing.h), used only with antialiasing.
  // Null means no 3D filter.
  const float* filters = nullptr;
};

/// Gradients of the loss with respect to the stored parameters. Every row is written. Gaussians that are not visible in
/// the view get zeros.
struct GaussianGradArrays {
  float* means = nullptr;            // [N, 3]
  float* log_scales = nullptr;       // [N, 3]
  float* quats = nullptr;            // [N, 4]
  float* logit_opacities = nullptr;  // [N]
  float* sh0 = nullptr;              // [N, 3]
  float* shN = nullptr;              // [N, K-1, 3] zero for coefficients above the rendered degree
  float* means2d = nullptr;          // [N, 2] gradient of the projected centre, 1/px
};

enum class Culling {
  kEllipse,  // tiles touched by the ellipse where alpha >= 1/255: shorter lists for the same image
  kSquare,   // all tiles of the 3-sigma square, as in the original rasterizer; cuts off the tails of opaque splats
};

/// Runs the forward blend of a view by calling blend(kernel) once, or several times to time kernels of the same family.
/// The last call determines the image and the data for the backward pass.
using BlendRunner = std::function<void(const std::function<void(ForwardKernel)>& blend)>;

struct RenderSettings {
  Vec3f background{0, 0, 0};      // RGB, multiplied by the final transmittance
  int sh_degree = 0;              // degree to render, at most sh_degree_max
  float near_plane = kNearPlane;  // world units; Gaussians with a smaller depth are culled
  Culling culling = Culling::kEllipse;
  std::optional<TileShape> tile{};  // overrides the tiles of the kernel's family (CPU only, for tests)
  ForwardKernel kernel = kStandardKernel;
  // Sums gradients in a fixed order. The paper's family does not support this on CUDA. The CPU always does it.
  bool deterministic = false;
  bool antialiasing = false;               // see antialiasing.h
  bool keep_for_backward = true;           // false saves memory and time if backward() is not called
  bool depth_gradient = true;              // false saves GPU memory if the depth image gets no gradient
  bool inverse_depth = false;              // the depth image is the sum of weight over depth, 1 / world units
  bool camera_gradient = false;            // backward() also computes the gradient of the camera's pose
  StageRecorder* stages = nullptr;         // notified when a stage begins; may be null
  const BlendRunner* run_blend = nullptr;  // null: runs `kernel` once
  cuda::ColorPass* color_pass = nullptr;   // CUDA: computes the colours of the splats; null: projection does

  TileShape tile_shape() const { return tile.value_or(tile_of(family_of(kernel))); }
};

/// Number of components of a camera pose gradient (math/gaussian_grad.h): rotation, then translation.
inline constexpr int kCameraGradients = 6;

/// A rendered view.
struct ImageArrays {
  float* color = nullptr;  // [H, W, 3] RGB, not clamped
  float* depth = nullptr;  // [H, W] sum of weight times depth (world units), not divided by alpha, or
                           // inverse depth (RenderSettings::inverse_depth)
  float* alpha = nullptr;  // [H, W] 1 - final transmittance
};

/// Gradients of the loss with respect to the rendered view. Null means zero.
struct ImageGradArrays {
  const float* color = nullptr;  // [H, W, 3]
  const float* depth = nullptr;  // [H, W]
  const float* alpha = nullptr;  // [H, W]
};

/// A Gaussian projected into one view. 48 bytes, three 16-byte loads. The exponent has base 2 and includes the opacity:
/// alpha = exp2(log2_opacity - d^T conic d) with d = pixel centre - mean.
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

/// Gradient of the loss with respect to a splat, summed over pixels by the backward blend. gaussian_grad.h turns it
/// into parameter gradients. With g = dL/d(ln alpha) and p = conic delta at a pixel (Footprint in blend.h), the sums
/// for mean and covariance are those of g p and g p p^T, which are multiples of the gradients (projection.h). The sums
/// use p instead of delta because along a needle delta is long and p is short, so multiplying by the conic after
/// summing would cancel the digits.
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

/// Result of binning: the (tile, splat) pairs, sorted by tile and then by depth. Each pair has an output index (slot).
/// The slots of one splat are contiguous, so gradients written to slots can be summed per splat in a fixed order. On
/// CUDA, the id of a splat is its row in cuda::ProjectOutputs, and M is the number of rows.
struct BinnedSplats {
  const std::int64_t* tile_offsets = nullptr;  // [n_tiles + 1] start of each tile's list in splat_ids
  const std::int32_t* splat_ids = nullptr;     // [n_pairs] in [0, M), nearest first within a tile
  const std::int64_t* pair_slots = nullptr;    // [n_pairs] slot of each pair
  const std::int64_t* slot_offsets = nullptr;  // [M + 1] first slot of each splat
  std::int64_t n_pairs = 0;
};

/// Inputs of all blending passes.
struct TileLists {
  const Splat* splats = nullptr;   // [M]
  const Vec2f* extents = nullptr;  // [M] half size of the box around alpha >= 1/255, px
  BinnedSplats bins{};
  TileGrid grid{};
};

/// Forward blend, from lists of splats to pixels.
struct BlendForwardArgs : TileLists {
  Vec3f background{};
  ImageArrays out{};
  float* transmittance = nullptr;    // [H, W] out: final transmittance, more exact than 1 - alpha
  std::int32_t* last_ids = nullptr;  // [H, W] out: position in the tile's list of the last splat blended, -1 if none
};

/// Backward blend. Takes the outputs of the forward blend and the gradients with respect to pixels, and computes one
/// SplatGrad per (tile, splat) pair.
struct BlendBackwardArgs : BlendForwardArgs {
  ImageGradArrays grad{};
  SplatGrad* pair_grads = nullptr;  // [n_pairs] out, indexed by slot; all are written
};

/// Load counting. Counts the list entries that each pixel evaluates, up to the one that finishes it, and those that it
/// blends. The counts are the same for every kernel, because entries evaluated beyond the end do not count.
struct CountLoadArgs : TileLists {
  std::int32_t* processed = nullptr;     // [H, W] out: entries evaluated
  std::int32_t* contributing = nullptr;  // [H, W] out: entries blended
};

/// Sums over the pixels of a view, and the values that they are added to. They are fixed-point, so a sum does not
/// depend on the order of its terms. The unit is 2^-24 (math/pixel_outputs.h), so 64 bits are enough for 2^40 pixels.
struct ScoreSums {
  std::uint64_t error, weight;
  float max_weight;
  std::uint32_t unused = 0;  // explicit padding, because ranks exchange all bytes
};

/// Scoring: sums of weights, and of errors times squared weights. It uses the arithmetic of the blend, entry by entry
/// in list order, so the result does not depend on the forward kernel.
struct ScoreArgs : TileLists {
  const float* error = nullptr;  // [H, W] clamped to [0, 1], NaN counts as 0
  ScoreSums* sums = nullptr;     // CPU: [n_pairs] out, indexed by slot, all are written. CUDA: [M] added to
};

/// Scores of the Gaussians that a view sees. All arrays are [N], in and out. Other Gaussians keep their values. The
/// weight of a Gaussian in a pixel is alpha times the transmittance in front of it, as in blending.
struct ScoreArrays {
  float* error_sum = nullptr;   // increased by the sum over pixels of weight^2 times error
  float* weight_sum = nullptr;  // increased by the sum of weights, px; null: not computed
  float* max_weight = nullptr;  // maximum of the old value and the largest weight in a pixel
  float* n_views = nullptr;     // increased by 1
};

/// Adds the sums of each splat to the entries of its Gaussian.
struct AddScoresArgs {
  const Splat* splats = nullptr;  // [M]
  std::int64_t n_splats = 0;
  const ScoreSums* sums = nullptr;  // [M]
  ScoreArrays out{};
};

// Views whose splats are projected by one rasterizer and rendered by another. A Gaussian that crosses the seam of a
// panorama also has only one row, for its first splat (math/project_splat.h). The renderer creates the second splat and
// adds its sums to those of the first.

/// Number of splats in a view.
struct SplatCounts {
  std::int64_t n_first = 0;   // visible Gaussians
  std::int64_t n_second = 0;  // Gaussians that a panorama draws a second time
};

/// M splats. If two have the same depth, the earlier one is in front.
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

// Backward projections that run later, after other views or on the rank that owns the Gaussians.

/// Sums of one splat, with everything needed to turn them into the gradient of its Gaussian.
struct alignas(16) SplatRecord {
  SplatGrad sum;
  std::int32_t gaussian;  // < N
  std::uint32_t clamped;  // as in Splat
};
static_assert(sizeof(SplatRecord) == 48, "three 16-byte words");

/// Stored splats of one view with N Gaussians and M splats.
struct SplatRecordArrays {
  SplatRecord* records = nullptr;              // [M] out, in any order
  std::int32_t* record_of_gaussian = nullptr;  // [N] out: index in `records`, -1 if the Gaussian is not visible
  float* means2d = nullptr;                    // [N, 2] out: gradient of the projected centre, 1/px; 0 if not visible
};

/// Sums of a splat from the backward blend, padded to three 16-byte words for vector atomics.
struct alignas(16) SplatGradSum {
  SplatGrad sum;
  float unused[2];  // 0
};
static_assert(sizeof(SplatGradSum) == 48, "three 16-byte words");

/// Stores the sums of splats that were rendered elsewhere, for a later backward projection.
struct KeepSplatsArgs {
  std::int64_t n_gaussians = 0;               // N
  SplatRows rows{};                           // as projected: Splat::gaussian < N, each at most once
  const SplatGradSum* splat_grads = nullptr;  // [M]
  SplatRecordArrays out{};                    // record m belongs to row m
  std::int32_t* radii = nullptr;              // [N] out: 0 if not visible
};

}  // namespace b3dgs
