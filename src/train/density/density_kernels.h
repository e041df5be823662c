// Kernels of density control for one Gaussian, on CPU and GPU: adding the statistics of a view, and sampling the
// positions of the parts of a split Gaussian.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/random.h"
#include "raster/args.h"
#include "raster/math/array_rows.h"
#include "raster/math/covariance.h"

namespace b3dgs {

/// Arguments of add_view_row(), with arrays as in DensityStatistics and ViewStatistics, all on one device.
struct AddViewArgs {
  const float* means2d_grad = nullptr;    // [N, 2] 1/px
  const std::int32_t* radii = nullptr;    // [N] px, 0 = not visible
  float half_width = 0, half_height = 0;  // px, of the image
  float* grad_norm_sum = nullptr;         // [N] normalised device coordinates
  std::int32_t* view_count = nullptr;     // [N]
  std::int32_t* max_radii = nullptr;      // [N] px
};

/// Adds the view to the statistics of Gaussian i. If the Gaussian is not visible, nothing changes.
B3DGS_HD void add_view_row(const AddViewArgs& args, std::int64_t i) {
  if (args.radii[i] <= 0) return;
  const float dx = args.means2d_grad[2 * i] * args.half_width, dy = args.means2d_grad[2 * i + 1] * args.half_height;
  args.grad_norm_sum[i] += std::sqrt(dx * dx + dy * dy);
  args.view_count[i] += 1;
  if (args.max_radii[i] < args.radii[i]) args.max_radii[i] = args.radii[i];
}

/// Returns the point at `offset` standard deviations along the axes of a Gaussian from its mean, in world space.
/// Computed in double, so that CPU and GPU differ by one ulp at most.
B3DGS_HD Vec3f displaced(const GaussianArrays& gaussians, std::int64_t row, const Vec3<double>& offset) {
  const Vec3f mean = load3(gaussians.means, row), s = load3(gaussians.log_scales, row);
  const Vec4f q = load4(gaussians.quats, row);
  const Vec3<double> moved = make_shape<double>({s.x, s.y, s.z}, {q.x, q.y, q.z, q.w}).factor * offset;
  return {static_cast<float>(mean.x + moved.x), static_cast<float>(mean.y + moved.y),
          static_cast<float>(mean.z + moved.z)};
}

inline constexpr int kSplitSamples = 2;  // parts of a split Gaussian

/// Arguments for sampling Gaussians that are split (Kerbl et al. 2023, section 5.2). All arrays are on one device.
struct SplitSampleArgs {
  const std::int64_t* rows = nullptr;  // [n] indices of the split Gaussians
  GaussianArrays gaussians{};
  RandomKey key{};
  int sample = 0;        // in [0, kSplitSamples): which sample of each Gaussian
  float* out = nullptr;  // [n, 3] out, world
};

/// Draws the sample of the i-th split Gaussian.
B3DGS_HD void draw_split_sample(const SplitSampleArgs& args, std::int64_t i) {
  const std::int64_t row = args.rows[i];
  const auto normal = random_normal(args.key, static_cast<std::uint64_t>(kSplitSamples * row + args.sample));
  store3(args.out, i, displaced(args.gaussians, row, Vec3<double>{normal[0], normal[1], normal[2]}));
}

}  // namespace b3dgs
