#include "train/gaussian_step.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch_launch.h"
#include "train/cuda/gaussian_step_cuda.h"
#endif

namespace b3dgs {

ViewStatistics step_gaussians(const GaussianStep& step, Rasterizer& rasterizer, const RenderedViewGrad& view_grad,
                              GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::GaussianStepArgs args;
    const ViewStatistics statistics = rasterizer.backward_blend(gaussians, view_grad, args.backward);
    begin_stage(step.stages, Stage::kOptimizer);
    args.adam = begin_adam_step(step.rates, gaussians, state);
    cuda::step_gaussians(args, torch_launch_context());
    end_stage(step.stages);
    return statistics;
  }
#endif
  const ViewStatistics statistics = rasterizer.backward(gaussians, view_grad, grads);
  begin_stage(step.stages, Stage::kOptimizer);
  adam_step(step.rates, grads, gaussians, state);
  end_stage(step.stages);
  return statistics;
}

}  // namespace b3dgs
