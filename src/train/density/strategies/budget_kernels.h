// Strategy budget for one Gaussian: the random key for drawing parents, and the two parts that replace a parent. CPU
// and GPU compute the same, in double.
#pragma once

#include <cmath>
#include <cstdint>

#include "config/choices.h"
#include "core/random.h"
#include "train/density/density_kernels.h"

namespace b3dgs {

/// Arguments of draw_parent_key(). All arrays are on one device.
struct ParentKeyArgs {
  const std::int64_t* rows = nullptr;  // [n] indices of the candidates
  const float* scores = nullptr;       // [N] above 0 for candidates
  RandomKey key{};
  float* keys = nullptr;  // [n] out
};

/// Writes key ln(u) / score of candidate i, with u uniform in (0, 1). The candidates with the k largest keys are a
/// sample without replacement, with probabilities proportional to the scores (Efraimidis and Spirakis 2006).
B3DGS_HD void draw_parent_key(const ParentKeyArgs& args, std::int64_t i) {
  const std::int64_t row = args.rows[i];
  const std::uint32_t bits = random_bits(args.key, static_cast<std::uint64_t>(row))[0];
  const double uniform = (bits + 0.5) * 0x1p-32;
  args.keys[i] = static_cast<float>(std::log(uniform) / static_cast<double>(args.scores[row]));
}

/// The parts of a split Gaussian relative to their parent.
struct SplitShape {
  double distance;              // from the mean of the parent, in its standard deviations along the longest axis
  double longest;               // factor of the scale along that axis
  double opacity, per_opacity;  // the opacity is o (opacity + per_opacity o), where o is the parent's
};

/// With kPreserve, the opacities of the parts are those that approximate the parent's image best, with both parts and
/// the parent composited. The best opacity is 0.577 o for small o and 0.683 o for o = 1, and a line fits those between
/// to 2 %. The root mean square difference from the parent's image is then 2 to 11 % of the image. With kMoments, it is
/// 24 to 28 %.
B3DGS_HD SplitShape split_shape(SplitRule rule) {
  if (rule == SplitRule::kMoments) return {0.8, 0.6, 0.5 / 0.6, 0};  // keeps the integral of opacity
  return {0.5, 0.86602540378443865, 0.57735026918962576, 0.107};     // 1/2, sqrt(3)/2
}

/// Arguments of make_part(). All arrays are on one device.
struct PartArgs {
  std::int64_t n_parents = 0;
  const std::int64_t* parents = nullptr;  // [n_parents] indices
  GaussianArrays gaussians{};
  SplitRule rule{};
  // Outputs: the first parts of all parents, then the second parts.
  float* out_means = nullptr;            // [2 n_parents, 3] world
  float* out_log_scales = nullptr;       // [2 n_parents, 3]
  float* out_logit_opacities = nullptr;  // [2 n_parents]
};

/// Writes part i, which belongs to parent i % n_parents.
B3DGS_HD void make_part(const PartArgs& args, std::int64_t i) {
  const std::int64_t side = i / args.n_parents, row = args.parents[i % args.n_parents];
  const float* const log_scale = args.gaussians.log_scales + 3 * row;
  const SplitShape split = split_shape(args.rule);
  int longest = 0;
  for (int axis = 1; axis < 3; ++axis) {
    if (log_scale[axis] > log_scale[longest]) longest = axis;
  }
  double offset[3]{0, 0, 0};  // in standard deviations
  offset[longest] = side == 0 ? split.distance : -split.distance;
  store3(args.out_means, i, displaced(args.gaussians, row, Vec3<double>{offset[0], offset[1], offset[2]}));
  for (int axis = 0; axis < 3; ++axis) {
    args.out_log_scales[3 * i + axis] =
        static_cast<float>(log_scale[axis] + (axis == longest ? std::log(split.longest) : 0));
  }
  const double parent_opacity = 1 / (1 + std::exp(-static_cast<double>(args.gaussians.logit_opacities[row])));
  const double opacity = parent_opacity * (split.opacity + split.per_opacity * parent_opacity);
  args.out_logit_opacities[i] = static_cast<float>(std::log(opacity / (1 - opacity)));
}

}  // namespace b3dgs
