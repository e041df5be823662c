// What density control does for one Gaussian, on CPU and GPU: the statistics of a view, and the positions of the parts
// of a split Gaussian.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/random.h"
#include "raster/math/covariance.h"

namespace b3dgs {

/// As DensityStatistics and ViewStatistics; all arrays are on one device.
struct AddViewArgs {
  std::int64_t n_gaussians = 0;
  const float* means2d_grad = nullptr;    // [N, 2] 1/px
  const std::int32_t* radii = nullptr;    // [N] px, 0 = not seen
  float half_width = 0, half_height = 0;  // px, of the image
  float* grad_norm_sum = nullptr;         // [N] normalised device coordinates
  std::int32_t* view_count = nullptr;     // [N]
  std::int32_t* max_radii = nullptr;      // [N] px
};

/// Gaussians that the view does not see keep their sums.
B3DGS_HD void add_view_row(const AddViewArgs& args, std::int64_t i) {
  using std::sqrt;
  if (args.radii[i] <= 0) return;
  const float dx = args.means2d_grad[2 * i] * args.half_width, dy = args.means2d_grad[2 * i + 1] * args.half_height;
  args.grad_norm_sum[i] += sqrt(dx * dx + dy * dy);
  args.view_count[i] += 1;
  if (args.max_radii[i] < args.radii[i]) args.max_radii[i] = args.radii[i];
}

inline constexpr int kSplitSamples = 2;  // parts of a split Gaussian

/// Samples of a Gaussian that is split (Kerbl et al. 2023, section 5.2). All arrays are on one device.
struct SplitSampleArgs {
  std::int64_t n_rows = 0;
  const std::int64_t* rows = nullptr;  // [n_rows] Gaussians that are split
  const float* means = nullptr;        // [N, 3] world
  const float* log_scales = nullptr;   // [N, 3]
  const float* quats = nullptr;        // [N, 4] w x y z
  RandomKey key{};
  int sample = 0;        // in [0, kSplitSamples): which sample of its row
  float* out = nullptr;  // [n_rows, 3] out, world
};

/// Sample i. Computed in double, so that CPU and GPU differ by one ulp at most.
B3DGS_HD void draw_split_sample(const SplitSampleArgs& args, std::int64_t i) {
  const std::int64_t row = args.rows[i];
  const float *mean = args.means + 3 * row, *log_scale = args.log_scales + 3 * row, *quat = args.quats + 4 * row;
  const auto normal = random_normal(args.key, static_cast<std::uint64_t>(kSplitSamples * row + args.sample));
  const Shape<double> shape =
      make_shape<double>({log_scale[0], log_scale[1], log_scale[2]}, {quat[0], quat[1], quat[2], quat[3]});
  const Vec3<double> offset = shape.factor * Vec3<double>{normal[0], normal[1], normal[2]};
  args.out[3 * i] = static_cast<float>(mean[0] + offset.x);
  args.out[3 * i + 1] = static_cast<float>(mean[1] + offset.y);
  args.out[3 * i + 2] = static_cast<float>(mean[2] + offset.z);
}

}  // namespace b3dgs
