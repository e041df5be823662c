#include "train/optimizer/gaussian_step.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/fused_step.h"
#include "raster/torch/torch_launch.h"
#include "train/optimizer/gaussian_step_cuda.h"
#endif

namespace b3dgs {
namespace {

#if B3DGS_TORCH_CUDA
cuda::ShRestArrays rest_arrays(GaussianTensors& gaussians, AdamState& state) {
  check_adam_state(gaussians, state);
  return {gaussians.size(), sh_degree_of(gaussians), gaussians.shN.data_ptr<float>(), state.m.shN.data_ptr<float>(),
          state.v.shN.data_ptr<float>()};
}
#endif

}  // namespace

struct GaussianStepper::Impl {
  explicit Impl(Rasterizer& with) : rasterizer(with) {}

  Rasterizer& rasterizer;
  GaussianTensors grads;  // on the CPU
#if B3DGS_TORCH_CUDA
  cuda::DeferredSh deferred_sh;
#endif
};

GaussianStepper::GaussianStepper(Rasterizer& rasterizer) : impl_(std::make_unique<Impl>(rasterizer)) {}
GaussianStepper::~GaussianStepper() = default;

RenderedView GaussianStepper::forward(GaussianTensors& gaussians, AdamState& state, const PinholeView& view,
                                      RenderSettings settings) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    begin_stage(settings.stages, Stage::kProject);
    impl_->deferred_sh.begin_view(rest_arrays(gaussians, state), settings.sh_degree, torch_launch_context());
    return FusedStep(impl_->rasterizer)
        .forward(gaussians, view, settings, settings.sh_degree > 0 ? &impl_->deferred_sh : nullptr);
  }
#endif
  (void)state;
  return impl_->rasterizer.forward(gaussians, view, settings);
}

ViewStatistics GaussianStepper::step(const AdamRates& rates, const RenderedViewGrad& view_grad,
                                     GaussianTensors& gaussians, AdamState& state, StageRecorder* stages) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::GaussianStepArgs args;
    const ViewStatistics statistics = FusedStep(impl_->rasterizer).backward_blend(gaussians, view_grad, args.backward);
    begin_stage(stages, Stage::kOptimizer);
    args.adam = begin_adam_step(rates, gaussians, state);
    args.updates = impl_->deferred_sh.updates();
    args.n_deferred = impl_->deferred_sh.n_deferred();
    cuda::step_gaussians(args, torch_launch_context());
    impl_->deferred_sh.defer_step(args.adam.back().size);
    end_stage(stages);
    return statistics;
  }
#endif
  const ViewStatistics statistics = impl_->rasterizer.backward(gaussians, view_grad, impl_->grads);
  begin_stage(stages, Stage::kOptimizer);
  adam_step(rates, impl_->grads, gaussians, state);
  end_stage(stages);
  return statistics;
}

void GaussianStepper::flush(GaussianTensors& gaussians, AdamState& state) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) impl_->deferred_sh.flush(rest_arrays(gaussians, state), torch_launch_context());
#endif
  (void)gaussians, (void)state;
}

}  // namespace b3dgs
