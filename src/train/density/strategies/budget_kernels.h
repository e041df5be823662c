// Strategy budget for one Gaussian: the key by which parents are drawn, and the two parts that replace a parent. CPU
// and GPU share this arithmetic, in double, so that they differ by about one ulp.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/random.h"
#include "raster/math/covariance.h"

namespace b3dgs {

/// All arrays are on one device.
struct ParentKeyArgs {
  std::int64_t n_rows = 0;
  const std::int64_t* rows = nullptr;  // [n_rows] candidates
  const float* scores = nullptr;       // [N] above 0 for candidates
  RandomKey key{};
  float* keys = nullptr;  // [n_rows] out
};

/// Key ln(u) / score of candidate i, with u uniform in (0, 1). The candidates with the k largest keys are a sample
/// without replacement, with probabilities proportional to the scores (Efraimidis and Spirakis 2006).
B3DGS_HD void draw_parent_key(const ParentKeyArgs& args, std::int64_t i) {
  const std::int64_t row = args.rows[i];
  const std::uint32_t bits = random_bits(args.key, static_cast<std::uint64_t>(row))[0];
  const double uniform = (bits + 0.5) * 0x1p-32;
  args.keys[i] = static_cast<float>(std::log(uniform) / static_cast<double>(args.scores[row]));
}

/// Where the two parts of a split Gaussian are placed on its longest axis (--split). Both rules preserve its mean and
/// covariance.
enum class SplitRule {
  kMoments,   // far apart (0.8^2 + 0.6^2 = 1)
  kPreserve,  // close enough to render like the parent
};

/// Distance of a part from its parent, in standard deviations along the longest axis; what that axis is multiplied by;
/// and what the parent's opacity o is multiplied by: opacity + per_opacity o.
struct SplitShape {
  double distance, longest, opacity, per_opacity;
};

/// kPreserve: the opacities of the parts that come closest to the parent's image, with both parts and the parent
/// composited, are 0.577 o for small o and 0.683 o for o = 1; a line fits those between to 2 %. The difference to the
/// parent's image, root mean square, is then 2 to 11 % of the image; it is 24 to 28 % with kMoments.
B3DGS_HD SplitShape split_shape(SplitRule rule) {
  if (rule == SplitRule::kMoments) return {0.8, 0.6, 0.5 / 0.6, 0};  // keeps the integral
  return {0.5, 0.86602540378443865, 0.57735026918962576, 0.107};     // 1/2, sqrt(3)/2
}

struct PartArgs {
  std::int64_t n_parents = 0;
  const std::int64_t* parents = nullptr;   // [n_parents] rows
  const float* means = nullptr;            // [N, 3] world
  const float* log_scales = nullptr;       // [N, 3]
  const float* quats = nullptr;            // [N, 4] w x y z
  const float* logit_opacities = nullptr;  // [N]
  SplitRule rule{};
  // Out: the first parts of all parents, then the second parts.
  float* out_means = nullptr;            // [2 n_parents, 3] world
  float* out_log_scales = nullptr;       // [2 n_parents, 3]
  float* out_logit_opacities = nullptr;  // [2 n_parents]
};

/// Writes part i, which belongs to parent i % n_parents.
B3DGS_HD void make_part(const PartArgs& args, std::int64_t i) {
  const std::int64_t side = i / args.n_parents, row = args.parents[i % args.n_parents];
  const float *mean = args.means + 3 * row, *log_scale = args.log_scales + 3 * row, *quat = args.quats + 4 * row;
  const SplitShape split = split_shape(args.rule);
  const Shape<double> shape =
      make_shape<double>({log_scale[0], log_scale[1], log_scale[2]}, {quat[0], quat[1], quat[2], quat[3]});
  int longest = 0;
  for (int axis = 1; axis < 3; ++axis) {
    if (log_scale[axis] > log_scale[longest]) longest = axis;
  }
  double offset[3]{0, 0, 0};  // in standard deviations
  offset[longest] = side == 0 ? split.distance : -split.distance;
  const Vec3<double> moved = shape.factor * Vec3<double>{offset[0], offset[1], offset[2]};
  args.out_means[3 * i] = static_cast<float>(mean[0] + moved.x);
  args.out_means[3 * i + 1] = static_cast<float>(mean[1] + moved.y);
  args.out_means[3 * i + 2] = static_cast<float>(mean[2] + moved.z);
  for (int axis = 0; axis < 3; ++axis) {
    args.out_log_scales[3 * i + axis] =
        static_cast<float>(log_scale[axis] + (axis == longest ? std::log(split.longest) : 0));
  }
  const double parent_opacity = 1 / (1 + std::exp(-static_cast<double>(args.logit_opacities[row])));
  const double opacity = parent_opacity * (split.opacity + split.per_opacity * parent_opacity);
  args.out_logit_opacities[i] = static_cast<float>(std::log(opacity / (1 - opacity)));
}

}  // namespace b3dgs
