#include "train/optimizer/gaussian_optimizer.h"

#include <algorithm>
#include <cmath>

#include "config/batch_steps.h"
#include "core/check.h"
#include "core/parallel.h"
#include "raster/math/array_rows.h"
#include "raster/torch/tensors.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_cuda.h"
#include "train/optimizer/gaussian_step.h"
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
  parallel_each(gaussians.size(), kGrain, [&](std::int64_t i) {
    if (radii[i] <= 0) return;
    Vec3f grad_row = load3(grad_log_scales, i);
    b3dgs::add_regularization(grad, logit_opacities[i], load3(log_scales, i), grad_logit_opacities[i], grad_row);
    store3(grad_log_scales, i, grad_row);
  });
}

/// Shrinks the SH coefficients beyond degree 0 (`n_rest` floats) of a Gaussian on the CPU.
void decay_row(float* rest, std::int64_t n_rest, float shrink) {
  if (shrink == 0) return;
  for (std::int64_t k = 0; k < n_rest; ++k) rest[k] = decayed(rest[k], shrink, static_cast<int>(k / 3));
}

/// Applies the decay of a step along one view from `center`, with gradients `grads`, on the CPU.
void decay_sh(const ShDecayArgs& args, float step_size, const Vec3f& center, const GaussianTensors& grads,
              GaussianTensors& gaussians) {
  constexpr std::int64_t kGrain = 4096;
  const auto* const means = gaussians.means.data_ptr<float>();
  const auto* const grad_colors = grads.sh0.data_ptr<float>();  // times a constant
  auto* const rests = gaussians.shN.data_ptr<float>();
  const std::int64_t n_rest = rest_floats(sh_degree_of(gaussians));
  parallel_each(gaussians.size(), kGrain, [&](std::int64_t i) {
    const Vec3f offset = load3(means, i) - center;
    SeenDirections seen;
    seen.add((1 / std::sqrt(dot(offset, offset))) * offset, load3(grad_colors, i));
    decay_row(rests + n_rest * i, n_rest, step_size * sh_decay(args, i, seen));
  });
}

/// Computes the gradients of the mean over the views on the CPU, and applies the decay to `rests`, the SH coefficients
/// beyond degree 0. `out.means2d` is not used. The result does not depend on the number of threads.
void batch_gradients(const BatchGradArgs& args, const ShDecayArgs& decay, float step_size, float* rests,
                     const GaussianGradArrays& out) {
  constexpr std::int64_t kGrain = 1024;
  const std::int64_t rest = rest_floats(args.gaussians.sh_degree_max);
  const float scale = 1.0f / static_cast<float>(args.n_views);
  const auto grad_of = args.lenses == nullptr
                           ? (args.antialiasing ? batch_grad<true, Pinhole> : batch_grad<false, Pinhole>)
                           : (args.antialiasing ? batch_grad<true, ViewLens> : batch_grad<false, ViewLens>);
  parallel_each(args.gaussians.n_gaussians, kGrain, [&](std::int64_t i) {
    float* const own_rest = out.shN + rest * i;
    std::fill_n(own_rest, rest, 0.0f);
    const BatchGrad grad = grad_of(args, i, args.sh_degree, scale, own_rest);
    store3(out.means, i, grad.mean);
    store3(out.log_scales, i, grad.log_scales);
    store4(out.quats, i, grad.quat);
    out.logit_opacities[i] = grad.logit_opacity;
    store3(out.sh0, i, grad.sh0);
    decay_row(rests + rest * i, rest, step_size * sh_decay(decay, i, grad.seen_from));
    if (grad.is_seen) std::transform(own_rest, own_rest + rest, own_rest, [&](float sum) { return scale * sum; });
  });
}

}  // namespace

GaussianOptimizer::GaussianOptimizer(Rasterizer& rasterizer, double sh_decay)
    : rasterizer_(rasterizer), sh_decay_(sh_decay) {
#if B3DGS_TORCH_CUDA
  deferred_sh_ = std::make_shared<cuda::DeferredSh>();
#endif
}

ShDecayArgs GaussianOptimizer::sh_decay(const AdamState& state, int n_views) const {
  if (!state.directions.defined()) return {};
  return sh_decay_args(state.directions.data_ptr<float>(), sh_decay_, n_views);
}

RenderSettings GaussianOptimizer::begin_view(GaussianTensors& gaussians, AdamState& state, RenderSettings settings) {
  if (sh_decay_ == 0 || gaussians.shN.size(1) == 0) {
    state.directions = torch::Tensor();
  } else if (!state.directions.defined()) {
    state.directions = torch::zeros({gaussians.size(), 4}, gaussians.means.options());
  }
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    begin_stage(settings.stages, Stage::kProject);
    deferred_sh_->begin_view(rest_arrays(gaussians, state), settings.sh_degree, torch_launch_context());
    if (settings.sh_degree > 0) settings.color_pass = deferred_sh_.get();
  }
#endif
  return settings;
}

ViewStatistics GaussianOptimizer::backward_and_step(const AdamRates& rates, const RenderedViewGrad& view_grad,
                                                    GaussianTensors& gaussians, AdamState& state, StageRecorder* stages,
                                                    const RegularizationWeights& regularization) {
  const RegularizationGrad own = regularization_grad(regularization, rasterizer_.view_size().n_splats);
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::GaussianStepArgs args;
    const ViewStatistics statistics = rasterizer_.backward_blend(gaussians, view_grad, args.backward);
    begin_stage(stages, Stage::kOptimizer);
    args.adam = begin_adam_step(rates, gaussians, state);
    deferred_sh_->begin_step(1, torch_launch_context());
    args.updates = deferred_sh_->updates();
    args.n_deferred = deferred_sh_->n_deferred();
    args.regularization = own;
    args.sh_decay = sh_decay(state, 1);
    cuda::step_gaussians(args, torch_launch_context());
    deferred_sh_->defer_step(args.adam[kShGroup].size);
    end_stage(stages);
    return statistics;
  }
#endif
  const ViewStatistics statistics = rasterizer_.backward(gaussians, view_grad, grads_);
  begin_stage(stages, Stage::kOptimizer);
  if (!own.is_zero()) add_regularization(own, gaussians, statistics, grads_);
  if (state.directions.defined()) {
    const AdamStepSize size = adam_step_size(rates[kShGroup], state.steps + 1);
    decay_sh(sh_decay(state, 1), size.step_size, rasterizer_.camera_center(), grads_, gaussians);
  }
  adam_step(rates, grads_, gaussians, state);
  end_stage(stages);
  return statistics;
}

void GaussianOptimizer::make_room_for_view(const GaussianTensors& gaussians) {
  make_room(gaussians, rasterizer_.view_size().n_splats);
}

void GaussianOptimizer::make_room(const GaussianTensors& gaussians, std::int64_t n_splats) {
  B3DGS_CHECK(n_kept_ < kMaxBatch, "a step has at most ", kMaxBatch, " views");
  constexpr std::int64_t kWords = sizeof(SplatRecord) / sizeof(float), kSpare = 4;
  if (views_.size() == n_kept_) views_.emplace_back();
  KeptView& next = views_[n_kept_];
  const torch::TensorOptions floats = gaussians.means.options();
  place_tensor(next.splats.records, next.record_room, {n_splats, kWords}, floats, kSpare);
  place_tensor(next.splats.record_of_gaussian, next.index_room, {gaussians.size()}, floats.dtype(torch::kInt32),
               kSpare);
  if (gaussians.means.is_cpu()) make_gradients(gaussians, grads_);
}

void GaussianOptimizer::keep(const CameraView& view, const RenderSettings& settings,
                             const RegularizationGrad& regularization) {
  if (n_kept_ == 0) kept_settings_ = settings;
  B3DGS_CHECK(kept_settings_.sh_degree == settings.sh_degree && kept_settings_.antialiasing == settings.antialiasing,
              "the views of a step have different settings");
  views_[n_kept_].view = view;
  views_[n_kept_++].regularization = regularization;
}

std::int64_t GaussianOptimizer::kept_bytes() const {
  std::size_t bytes = 0;
  for (const KeptView& view : views_) {
    for (const torch::Tensor* room : {&view.record_room, &view.index_room}) {
      if (room->defined()) bytes += room->storage().nbytes();
    }
  }
  return static_cast<std::int64_t>(bytes);
}

ViewStatistics GaussianOptimizer::backward_and_keep(const CameraView& view, const RenderSettings& settings,
                                                    const RenderedViewGrad& view_grad, const GaussianTensors& gaussians,
                                                    const RegularizationWeights& regularization) {
  const ViewStatistics statistics = rasterizer_.backward_to_splats(gaussians, view_grad, views_.at(n_kept_).splats);
  keep(view, settings, regularization_grad(regularization, rasterizer_.view_size().n_splats));
  return statistics;
}

std::vector<ViewSplats> GaussianOptimizer::project_views(GaussianTensors& gaussians, AdamState& state,
                                                         const std::vector<CameraView>& views,
                                                         const std::vector<RenderSettings>& settings) {
  std::vector<RenderSettings> begun = settings;
  for (RenderSettings& each : begun) each = begin_view(gaussians, state, each);
  return rasterizer_.project_views(gaussians, views, begun);
}

ViewStatistics GaussianOptimizer::keep_splats(const ViewSplats& own, const torch::Tensor& splat_grads,
                                              const CameraView& view, const RenderSettings& settings,
                                              const GaussianTensors& gaussians, std::int64_t n_splats,
                                              const RegularizationWeights& regularization) {
  make_room(gaussians, own.size());
  const ViewStatistics statistics = owner_.keep(own, splat_grads, gaussians.size(), views_[n_kept_].splats);
  keep(view, settings, regularization_grad(regularization, n_splats));
  return statistics;
}

void GaussianOptimizer::step_views(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state,
                                   StageRecorder* stages) {
  B3DGS_CHECK(n_kept_ > 0, "a step without views");
  const int n_views = n_kept_views();
  AdamRates scaled = rates;
  for (double& rate : scaled) rate *= std::sqrt(n_views);
  BatchGradArgs grad_args;
  grad_args.gaussians = arrays_of(gaussians, gaussians.means.device());
  grad_args.sh_degree = kept_settings_.sh_degree;
  grad_args.antialiasing = kept_settings_.antialiasing;
  grad_args.n_views = n_views;
  std::vector<ViewLens> lenses;
  lenses.reserve(n_kept_);
  for (std::size_t v = 0; v < n_kept_; ++v) {
    const KeptView& kept = views_[v];
    B3DGS_CHECK(kept.splats.record_of_gaussian.numel() == gaussians.size(), "a view of ",
                kept.splats.record_of_gaussian.numel(), " Gaussians in a step of ", gaussians.size());
    grad_args.views[v] = {kept.view, reinterpret_cast<const SplatRecord*>(kept.splats.records.data_ptr<float>()),
                          kept.splats.record_of_gaussian.data_ptr<std::int32_t>(), kept.regularization};
    lenses.push_back(kept.view.lens);
    if (kept.view.lens.kind != LensKind::kPinhole) grad_args.lenses = lenses.data();
  }
  begin_stage(stages, Stage::kOptimizer);
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) {
    cuda::BatchStepArgs args;
    args.grad = grad_args;
    torch::Tensor on_gpu;  // freed in the order of the stream
    if (grad_args.lenses != nullptr) {
      constexpr std::int64_t kWords = sizeof(ViewLens) / sizeof(float);
      on_gpu = torch::from_blob(lenses.data(), {n_views, kWords}, torch::kFloat32)
                   .to(gaussians.means.device(), /*non_blocking=*/true);  // CUDA has copied `lenses` when this returns
      args.grad.lenses = reinterpret_cast<const ViewLens*>(on_gpu.data_ptr<float>());
    }
    args.adam = begin_adam_step(scaled, gaussians, state, n_views);
    args.rule = adam_rule(n_views);
    deferred_sh_->begin_step(n_views, torch_launch_context());
    args.updates = deferred_sh_->updates();
    args.n_deferred = deferred_sh_->n_deferred();
    args.sh_decay = sh_decay(state, n_views);
    cuda::step_batch(args, torch_launch_context());
    deferred_sh_->defer_step(args.adam[kShGroup].size);
  }
#endif
  if (gaussians.means.is_cpu()) {
    const AdamStepSize size = adam_step_size(scaled[kShGroup], state.steps + n_views);
    batch_gradients(grad_args, sh_decay(state, n_views), size.step_size, gaussians.shN.data_ptr<float>(),
                    make_gradients(gaussians, grads_));
    adam_step(scaled, grads_, gaussians, state, n_views);
  }
  drop_views();
  end_stage(stages);
}

void GaussianOptimizer::flush([[maybe_unused]] GaussianTensors& gaussians, [[maybe_unused]] AdamState& state) {
#if B3DGS_TORCH_CUDA
  if (!gaussians.means.is_cpu()) deferred_sh_->flush(rest_arrays(gaussians, state), torch_launch_context());
#endif
}

}  // namespace b3dgs
