// What goes into and comes out of the rasterizer and each of its passes. Pointers and sizes only: whoever fills a
// struct owns the memory, which is contiguous and lies on one device. Shapes stand beside the pointers; N is the number
// of Gaussians, M that of splats (Gaussians seen in the view), K = (sh_degree_max + 1)^2.
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "raster/backward_kernel.h"
#include "raster/constants.h"
#include "raster/forward_kernel.h"
#include "raster/stages.h"

namespace b3dgs {

namespace cuda {
class ColorPass;
}

/// One pinhole view. Camera frame: +x right, +y down, +z forward; the centre of pixel (i, j) is (i + 0.5, j + 0.5).
struct PinholeView {
  Mat3f rotation;              // cam_from_world
  Vec3f translation;           // cam_from_world
  Vec3f center;                // camera centre, world
  float fx, fy, cx, cy;        // px
  std::int32_t width, height;  // px
};

/// Stored (pre-activation) parameters of all Gaussians.
struct GaussianArrays {
  std::int64_t n_gaussians = 0;
  int sh_degree_max = 0;                   // what shN has room for
  const float* means = nullptr;            // [N, 3] world
  const float* log_scales = nullptr;       // [N, 3]
  const float* quats = nullptr;            // [N, 4] w x y z, any length but 0
  const float* logit_opacities = nullptr;  // [N]
  const float* sh0 = nullptr;              // [N, 3]
  const float* shN = nullptr;              // [N, K-1, 3]
};

/// Gradients of the loss by the stored parameters; every row is written, with zeros for Gaussians the view does not
/// see.
struct GaussianGradArrays {
  float* means = nullptr;            // [N, 3]
  float* log_scales = nullptr;       // [N, 3]
  float* quats = nullptr;            // [N, 4]
  float* logit_opacities = nullptr;  // [N]
  float* sh0 = nullptr;              // [N, 3]
  float* shN = nullptr;              // [N, K-1, 3]; coefficients above the rendered degree get 0
  float* means2d = nullptr;          // [N, 2] by the projected centre, in 1/px
};

enum class Culling {
  kEllipse,  // tiles that the ellipse alpha >= 1/255 touches, exactly: no image differs, lists are shorter
  kSquare,   // all tiles of the 3-sigma square, as the original rasterizer: tails of opaque splats end there
};

/// Size of the binning unit in px.
struct TileShape {
  std::int32_t width = 16, height = 16;
};

struct RenderSettings {
  Vec3f background{0, 0, 0};      // RGB, seen through what the Gaussians leave of the light
  int sh_degree = 0;              // of the colours, at most sh_degree_max
  float near_plane = kNearPlane;  // world units; Gaussians nearer than this are not seen
  Culling culling = Culling::kEllipse;
  TileShape tile{};
  ForwardKernel kernel = ForwardKernel::kSharedMemory;
  BackwardKernel backward_kernel = BackwardKernel::kPerSplat;  // on CUDA
  bool deterministic = false;                                  // sums in a fixed order on CUDA; the CPU always does
  bool keep_for_backward = true;          // false saves memory and time where no gradient is wanted
  bool depth_gradient = true;             // false saves on CUDA what a gradient by depth would need
  StageRecorder* stages = nullptr;        // told which pass begins, of the backward passes too; null: nobody asks
  cuda::ColorPass* color_pass = nullptr;  // on CUDA: finds the colours; null: the rasterizer does
};

/// The rendered view.
struct ImageArrays {
  float* color = nullptr;  // [H, W, 3] RGB, not clamped
  float* depth = nullptr;  // [H, W] sum of weight times view-space z (world units), not divided by alpha
  float* alpha = nullptr;  // [H, W] 1 - final transmittance
};

/// Gradients of the loss by the rendered view; a null pointer stands for zeros.
struct ImageGradArrays {
  const float* color = nullptr;  // [H, W, 3]
  const float* depth = nullptr;  // [H, W]
  const float* alpha = nullptr;  // [H, W]
};

/// A Gaussian as one view sees it: 48 bytes, three 16-byte loads. Exponents are kept in base 2 and the opacity inside
/// them, so that alpha = exp2(log2_opacity - d^T conic d), d = pixel - mean.
struct alignas(16) Splat {
  float mean_x, mean_y;                // px
  float log2_opacity;                  // <= 0
  float depth;                         // view-space z, world units
  float conic_xx, conic_xy, conic_yy;  // inverse 2D covariance (1/px^2), times kConicScale
  std::int32_t gaussian;               // index of the Gaussian, < N
  float red, green, blue;              // clamped at 0
  std::uint32_t clamped;               // bit c: channel c was clamped, its colour has no gradient
};
static_assert(sizeof(Splat) == 48, "three 16-byte loads");

/// Sums over the pixels of a splat of q = dL/d(ln alpha) and of its first and second moments with the pull conic d
/// (Reach in blend.h), and of the gradients by colour and depth. What the blending pass leaves; projection.h turns it
/// into parameter gradients. Moments of the pull, not of d itself: along a needle d is long and the pull is short, and
/// multiplying by the conic only after summing would lose the difference.
struct SplatGrad {
  float q, q_x, q_y, q_xx, q_xy, q_yy;
  float red, green, blue;
  float depth;
};

/// Tiles of an image, row by row.
struct TileGrid {
  std::int32_t image_width = 0, image_height = 0;  // px
  TileShape tile{};
  std::int32_t columns = 0, rows = 0;
  B3DGS_HD std::int32_t n_tiles() const { return columns * rows; }
};

/// Projection: Gaussians to the splats of one view, in the order of the Gaussians.
struct ProjectArgs {
  GaussianArrays gaussians{};
  PinholeView view{};
  int sh_degree = 0;
  float near_plane = kNearPlane;  // world units
  Culling culling = Culling::kEllipse;
  TileGrid grid{};
  Splat* splats = nullptr;        // [N] out, the first M are written
  Vec2f* extents = nullptr;       // [N] out, first M: half width and height (px) of the box around alpha >= 1/255
  std::int32_t* radii = nullptr;  // [N] out: 3 standard deviations in px, rounded up; 0 if the Gaussian is not seen
};

/// Binning: splats to the lists of the tiles, nearest first; equal depths in the order of the Gaussians.
struct BinArgs {
  const Splat* splats = nullptr;
  const Vec2f* extents = nullptr;
  const std::int32_t* radii = nullptr;  // [N]
  std::int64_t n_splats = 0;            // M
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
};

/// What binning leaves. Pairs of a tile lie together in splat_ids; the slots of a splat's pairs lie together too, so
/// that gradients written there are summed in a fixed order.
struct BinnedSplats {
  const std::int64_t* tile_offsets = nullptr;  // [n_tiles + 1] into splat_ids
  const std::int32_t* splat_ids = nullptr;     // [n_isects] in [0, M), nearest first within a tile
  const std::int64_t* isect_slots = nullptr;   // [n_isects] slot of each pair
  const std::int64_t* slot_offsets = nullptr;  // [M + 1] slots of each splat
  std::int64_t n_isects = 0;
};

/// Forward blend: sorted splats to pixels.
struct BlendForwardArgs {
  const Splat* splats = nullptr;   // [M]
  const Vec2f* extents = nullptr;  // [M]
  BinnedSplats bins{};
  TileGrid grid{};
  Vec3f background{};
  ImageArrays out{};
  float* transmittance = nullptr;  // [H, W] out, final: 1 - alpha has lost its last digits
  std::int32_t* last_ids =
      nullptr;  // [H, W] out, position within the tile's list of the last blended splat, -1 if none
};

/// Counting: how many entries of its tile's list the forward blend looks at for each pixel, and how many it blends. The
/// same for every schedule, lanes that look further ahead in vain not counted.
struct CountLoadArgs {
  const Splat* splats = nullptr;  // [M]
  BinnedSplats bins{};
  TileGrid grid{};
  std::int32_t* processed = nullptr;     // [H, W] out
  std::int32_t* contributing = nullptr;  // [H, W] out
};

/// Backward blend: gradients by pixels to gradients by splats, one record per (tile, splat) pair.
struct BlendBackwardArgs {
  const Splat* splats = nullptr;
  const Vec2f* extents = nullptr;
  BinnedSplats bins{};
  TileGrid grid{};
  Vec3f background{};
  // As the forward pass left them.
  ImageArrays rendered{};
  const float* transmittance = nullptr;    // [H, W]
  const std::int32_t* last_ids = nullptr;  // [H, W]
  ImageGradArrays grad{};
  SplatGrad* isect_grads = nullptr;  // [n_isects] out, by slot; every record is written
};

/// Projection backward: gradients by splats to gradients by the stored parameters.
struct ProjectBackwardArgs {
  GaussianArrays gaussians{};
  PinholeView view{};
  int sh_degree = 0;
  const Splat* splats = nullptr;  // [M]
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGrad* isect_grads = nullptr;      // [n_isects] by slot
  GaussianGradArrays grad{};
};

}  // namespace b3dgs
