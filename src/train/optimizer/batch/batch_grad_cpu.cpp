#include "train/optimizer/batch/batch_grad_cpu.h"

#include <algorithm>

#include "core/parallel.h"

namespace b3dgs::cpu {

void batch_gradients(const BatchGradArgs& args, const GaussianGradArrays& out) {
  constexpr std::int64_t kGrain = 1024;
  const std::int64_t rest = rest_floats(args.gaussians.sh_degree_max);
  const float scale = 1.0f / static_cast<float>(args.n_views);
  parallel_chunks(args.gaussians.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.shN + rest * begin, out.shN + rest * end, 0.0f);
    for (std::int64_t i = begin; i < end; ++i) {
      float* const own_rest = out.shN + rest * i;
      const BatchGrad grad = args.antialiasing ? batch_grad<true>(args, i, args.sh_degree, scale, own_rest)
                                               : batch_grad<false>(args, i, args.sh_degree, scale, own_rest);
      store3(out.means, i, grad.mean);
      store3(out.log_scales, i, grad.log_scales);
      store4(out.quats, i, grad.quat);
      out.logit_opacities[i] = grad.logit_opacity;
      store3(out.sh0, i, grad.sh0);
      if (grad.is_seen) std::transform(own_rest, own_rest + rest, own_rest, [&](float sum) { return scale * sum; });
    }
  });
}

}  // namespace b3dgs::cpu
