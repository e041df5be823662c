#include "train/optimizer/gaussian_optimizer.h"

#include <cmath>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/math/array_rows.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_cuda.h"
#include "train/optimizer/deferred_sh.h"
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

/// Adds the gradients of the regularisation on the CPU.
void add_regularization(const RegularizationGrad& grad, const GaussianTensors& gaussians,
                        const ViewStatistics& statistics, GaussianTensors& grads) {
  constexpr std::int64_t kGrain = 4096;
  const auto* const radii = statistics.radii.data_ptr<std::int32_t>();
  const auto* const logit_opacities = gaussians.logit_opacities.data_ptr<float>();
  const auto* const log_scales = gaussians.log_scales.data_ptr<float>();
  auto* const grad_logit_opacities = grads.logit_opacities.data_ptr<float>();
  auto* const grad_log_scales = grads.log_scales.data_ptr<float>();
  parallel_chunks(gaussians.size(), kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      if (radii[i] <= 0) continue;
      Vec3f grad_row = load3(grad_log_scales, i);
      b3dgs::add_regularization(grad, logit_opacities[i], load3(log_scales, i), grad_logit_opacities[i], grad_row);
      store3(grad_log_scales, i, grad_row);
    }
  });
}

/// Tensors that a forward pass has checked.
GaussianArrays arrays_of(const GaussianTensors& g) {
  return {g.size(),
          sh_degree_of(g),
          g.means.data_ptr<float>(),
          g.log_scales.data_ptr<float>(),
          g.quats.data_ptr<float>(),
          g.logit_opacities.data_ptr<float>(),
          g.sh0.data_ptr<float>(),
          g.shN.data_ptr<float>(),
          g.filters.defined() ? g.filters.data_ptr<float>() : nullptr};
}

}  // namespace

GaussianOptimizer::GaussianOptimizer(Rasterizer& rasterizer) : rasterizer_(rasterizer) {
#if B3DGS_TORCH_CUDA
  deferred_sh_ = std::make_shared<cuda::DeferredSh>();
#endif
}

RenderSettings GaussianOptimizer::begin_view([[maybe_unused]] GaussianTensors& gaussians,
                                             [[maybe_unused]] AdamState& state, RenderSettings settings) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    begin_stage(settings.stages, Stage::kProject);
    deferred_sh_->begin_view(rest_arrays(gaussians, state), settings.sh_degree, torch_launch_context());
    if (settings.sh_degree > 0) settings.color_pass = deferred_sh_.get();
  }
#endif
  return settings;
}

ViewStatistics GaussianOptimizer::step(const AdamRates& rates, const RenderedViewGrad& view_grad,
                                       GaussianTensors& gaussians, AdamState& state, StageRecorder* stages,
                                       const RegularizationWeights& regularization) {
  const RegularizationGrad regularization_grad =
      b3dgs::regularization_grad(regularization, rasterizer_.view_size().n_splats);
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::GaussianStepArgs args;
    const ViewStatistics statistics = rasterizer_.backward_blend(gaussians, view_grad, args.backward);
    begin_stage(stages, Stage::kOptimizer);
    args.adam = begin_adam_step(rates, gaussians, state);
    args.updates = deferred_sh_->updates();
    args.n_deferred = deferred_sh_->n_deferred();
    args.regularization = regularization_grad;
    cuda::step_gaussians(args, torch_launch_context());
    deferred_sh_->defer_step(args.adam.back().size);
    end_stage(stages);
    return statistics;
  }
#endif
  const ViewStatistics statistics = rasterizer_.backward(gaussians, view_grad, grads_);
  begin_stage(stages, Stage::kOptimizer);
  if (!regularization_grad.is_zero()) add_regularization(regularization_grad, gaussians, statistics, grads_);
  adam_step(rates, grads_, gaussians, state);
  end_stage(stages);
  return statistics;
}

void GaussianOptimizer::make_room_for_view(const GaussianTensors& gaussians) {
  make_room(gaussians, rasterizer_.view_size().n_splats);
}

void GaussianOptimizer::make_room(const GaussianTensors& gaussians, std::int64_t n_splats) {
  batch_.make_room(gaussians.size(), n_splats, gaussians.means.device());
  if (!gaussians.means.is_cpu()) return;
  for (std::size_t i = 0; i < gaussians.all().size(); ++i) {
    torch::Tensor& grad = *grads_.all()[i];
    const torch::Tensor& parameter = *gaussians.all()[i];
    if (!grad.defined() || grad.sizes() != parameter.sizes()) grad = torch::empty_like(parameter);
  }
}

ViewStatistics GaussianOptimizer::keep_view(const CameraView& view, const RenderSettings& settings,
                                            const RenderedViewGrad& view_grad, const GaussianTensors& gaussians,
                                            const RegularizationWeights& regularization) {
  const ViewStatistics statistics = rasterizer_.backward_to_splats(gaussians, view_grad, batch_.room());
  batch_.add(view, settings, b3dgs::regularization_grad(regularization, rasterizer_.view_size().n_splats));
  return statistics;
}

std::vector<ViewSplats> GaussianOptimizer::project_views(GaussianTensors& gaussians, AdamState& state,
                                                         const std::vector<CameraView>& views,
                                                         const std::vector<RenderSettings>& settings) {
  std::vector<RenderSettings> begun;
  for (const RenderSettings& each : settings) begun.push_back(begin_view(gaussians, state, each));
  return rasterizer_.project_views(gaussians, views, begun);
}

ViewStatistics GaussianOptimizer::keep_splats(const ViewSplats& own, const torch::Tensor& sums, const CameraView& view,
                                              const RenderSettings& settings, const GaussianTensors& gaussians,
                                              std::int64_t n_splats, const RegularizationWeights& regularization) {
  make_room(gaussians, own.size());
  const ViewStatistics statistics = owner_.keep(own, sums, gaussians.size(), batch_.room());
  batch_.add(view, settings, b3dgs::regularization_grad(regularization, n_splats));
  return statistics;
}

void GaussianOptimizer::step_views(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state,
                                   StageRecorder* stages) {
  const int n_views = batch_.n_views();
  B3DGS_CHECK(n_views > 0, "a step without views");
  AdamRates scaled = rates;
  for (double& rate : scaled) rate *= std::sqrt(n_views);
  const BatchGradArgs grad_args = batch_.grad_args(arrays_of(gaussians));
  begin_stage(stages, Stage::kOptimizer);
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::BatchStepArgs args;
    args.grad = grad_args;
    torch::Tensor lenses;  // freed in the order of the stream
    if (grad_args.lenses != nullptr) {
      constexpr std::int64_t kWords = sizeof(ViewLens) / sizeof(float);
      lenses = torch::from_blob(const_cast<ViewLens*>(grad_args.lenses), {n_views, kWords}, torch::kFloat32)
                   .to(gaussians.means.device());
      args.grad.lenses = reinterpret_cast<const ViewLens*>(lenses.data_ptr<float>());
    }
    args.adam = begin_adam_step(scaled, gaussians, state, n_views);
    args.rule = adam_rule(n_views);
    args.updates = deferred_sh_->updates();
    args.n_deferred = deferred_sh_->n_deferred();
    cuda::step_batch(args, torch_launch_context());
    deferred_sh_->defer_step(args.adam.back().size, args.rule);
    batch_.clear();
    end_stage(stages);
    return;
  }
#endif
  cpu::batch_gradients(grad_args, {grads_.means.data_ptr<float>(), grads_.log_scales.data_ptr<float>(),
                                   grads_.quats.data_ptr<float>(), grads_.logit_opacities.data_ptr<float>(),
                                   grads_.sh0.data_ptr<float>(), grads_.shN.data_ptr<float>(), nullptr});
  adam_step(scaled, grads_, gaussians, state, n_views);
  batch_.clear();
  end_stage(stages);
}

void GaussianOptimizer::flush([[maybe_unused]] GaussianTensors& gaussians, [[maybe_unused]] AdamState& state) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) deferred_sh_->flush(rest_arrays(gaussians, state), torch_launch_context());
#endif
}

}  // namespace b3dgs
