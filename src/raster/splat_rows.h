// What stands between the passes of a view, for views that are split there: splats as rows of an array, so that
// Gaussians can be projected by one rasterizer and drawn by another; and what the backward blend leaves for the
// backward projection, kept so that this can follow after other views.
#pragma once

#include <cstdint>
#include <functional>

#include "raster/args.h"

namespace b3dgs {

// A Gaussian that crosses the seam of a panorama has one row, too: that of its first splat (math/project_splat.h).
// Whoever draws the rows makes the second splat, and adds its sums to those of the first.

/// Numbers of splats of a view.
struct SplatCounts {
  std::int64_t n_first = 0;   // of Gaussians that the view sees
  std::int64_t n_second = 0;  // of those that a panorama draws twice
};

/// M splats. Of two at the same depth, the earlier one is in front.
struct SplatRows {
  std::int64_t n_splats = 0;            // M
  const Splat* splats = nullptr;        // [M]
  const Vec2f* extents = nullptr;       // [M] half size of the box around alpha >= 1/255, px
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

/// What the gradient with respect to the camera's pose depends on besides splats.
struct CameraPartsView {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  bool antialiasing = false;
};

/// What each splat adds to the gradient with respect to the camera's pose (math/gaussian_grad.h).
struct CameraPartsArgs {
  CameraPartsView of{};
  std::int64_t n_splats = 0;                  // M
  const Splat* splats = nullptr;              // [M] as projected
  const SplatGradSum* splat_grads = nullptr;  // [M]
  float* out = nullptr;                       // [M, kCameraGradients] out
};

/// Keeps the sums of splats that were drawn elsewhere, for a later backward projection.
struct KeepSplatsArgs {
  std::int64_t n_gaussians = 0;               // N
  SplatRows rows{};                           // as projected: Splat::gaussian < N, each at most once
  const SplatGradSum* splat_grads = nullptr;  // [M]
  SplatRecordArrays out{};                    // record m is that of row m
  std::int32_t* radii = nullptr;              // [N] out: 0 if not seen
};

}  // namespace b3dgs
