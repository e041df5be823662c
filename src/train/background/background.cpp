#include "train/background/background.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensor_check.h"
#include "raster/torch/tensor_storage.h"
#include "train/background/background_args.h"
#include "train/optimizer/adam.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_launch.h"
#include "train/background/background_cuda.h"
#endif

namespace b3dgs {
namespace {

int degree_of(const torch::Tensor& coefficients, torch::Device device) {
  TensorCheck(device).dims("coefficients", coefficients, {"K", 3});
  for (const int degree : {0, kBackgroundDegree}) {
    if (coefficients.size(0) == background_coefficients(degree)) return degree;
  }
  throw LogicError(detail::concat("a background has ", coefficients.size(0), " coefficients, expected 1 or ",
                                  kBackgroundCoefficients));
}

/// @throws LogicError unless the render has the size of the view
void check_size(const PinholeView& view, const RenderedView& rendered) {
  TensorCheck check(rendered.color.device());
  check.dims("rendered.color", rendered.color, {view.height, view.width, 3});
  check.dims("rendered.alpha", rendered.alpha, {view.height, view.width});
}

/// Calls body(part, begin, end) for each part of the pixels, on the threads of the CPU.
template <class Body>
void for_parts(const PinholeView& view, Body&& body) {
  const std::int64_t n_pixels = std::int64_t{view.width} * view.height;
  parallel_pool(background_parts(view), [&](std::int64_t part, int) {
    body(part, part * kBackgroundPart, std::min((part + 1) * kBackgroundPart, n_pixels));
  });
}

template <int kDegree>
void add_on_cpu(const BackgroundArgs& args) {
  for_parts(args.view, [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t p = begin; p < end; ++p) add_background_at<kDegree>(args, p);
  });
}

template <int kDegree>
void gradient_on_cpu(const BackgroundGradArgs& args) {
  constexpr int kSums = 3 * background_coefficients(kDegree);
  for_parts(args.view, [&](std::int64_t part, std::int64_t begin, std::int64_t end) {
    float sums[kSums]{};
    for (std::int64_t p = begin; p < end; ++p) background_grad_at<kDegree>(args, p, sums);
    std::copy_n(sums, kSums, args.parts + part * kSums);
  });
  for (int i = 0; i < kSums; ++i) {
    double sum = 0;
    for (std::int64_t part = 0; part < background_parts(args.view); ++part) {
      sum += static_cast<double>(args.parts[part * kSums + i]);
    }
    args.grad_coefficients[i] = static_cast<float>(sum);
  }
}

}  // namespace

BackgroundState make_background(int degree, torch::Device device) {
  if (degree < 0) return {};
  const torch::Tensor zeros =
      torch::zeros({background_coefficients(degree), 3}, torch::TensorOptions(device).dtype(torch::kFloat32));
  return {zeros, zeros.clone(), zeros.clone(), 0};
}

void add_background(const torch::Tensor& coefficients, const PinholeView& view, const RenderedView& rendered) {
  if (!coefficients.defined()) return;
  check_size(view, rendered);
  const BackgroundArgs args{view, degree_of(coefficients, rendered.color.device()), coefficients.data_ptr<float>(),
                            rendered.alpha.data_ptr<float>(), rendered.color.data_ptr<float>()};
#if B3DGS_TORCH_CUDA
  if (rendered.color.is_cuda()) return cuda::add_background(args, torch_launch_context().stream);
#endif
  args.degree == 0 ? add_on_cpu<0>(args) : add_on_cpu<kBackgroundDegree>(args);
}

torch::Tensor BackgroundGradient::compute(const BackgroundState& background, const PinholeView& view,
                                          const RenderedView& rendered, const torch::Tensor& grad_color) {
  check_size(view, rendered);
  TensorCheck(rendered.color.device()).dims("grad_color", grad_color, {view.height, view.width, 3});
  const torch::TensorOptions options = rendered.color.options();
  const int degree = degree_of(background.coefficients, rendered.color.device());
  place_tensor(alpha_, alpha_room_, rendered.alpha.sizes(), options);
  place_tensor(parts_, parts_room_, {background_parts(view), 3 * background.coefficients.size(0)}, options);
  if (!grad_.defined() || grad_.sizes() != background.coefficients.sizes()) {
    grad_ = torch::empty_like(background.coefficients);
  }
  BackgroundGradArgs args;
  args.view = view;
  args.degree = degree;
  args.coefficients = background.coefficients.data_ptr<float>();
  args.alpha = rendered.alpha.data_ptr<float>();
  args.grad_color = grad_color.data_ptr<float>();
  args.grad_alpha = alpha_.data_ptr<float>();
  args.parts = parts_.data_ptr<float>();
  args.grad_coefficients = grad_.data_ptr<float>();
#if B3DGS_TORCH_CUDA
  if (rendered.color.is_cuda()) {
    cuda::background_gradient(args, torch_launch_context().stream);
    return alpha_;
  }
#endif
  degree == 0 ? gradient_on_cpu<0>(args) : gradient_on_cpu<kBackgroundDegree>(args);
  return alpha_;
}

namespace {

AdamArgs step_args(double rate, const torch::Tensor& grad, BackgroundState& background) {
  AdamArgs args;
  args.n = background.coefficients.numel();
  args.param = background.coefficients.data_ptr<float>();
  args.grad = grad.data_ptr<float>();
  args.m = background.m.data_ptr<float>();
  args.v = background.v.data_ptr<float>();
  args.size = adam_step_size(rate, background.steps);
  return args;
}

}  // namespace

void BackgroundGradient::step(double rate, BackgroundState& background) const {
  ++background.steps;
  const AdamArgs args = step_args(rate, grad_, background);
#if B3DGS_TORCH_CUDA
  if (background.coefficients.is_cuda()) return cuda::step_background(args, torch_launch_context().stream);
#endif
  cpu::adam_step(args);
}

void BackgroundGradient::add_to_sum(const torch::Tensor& coefficients, bool is_first) {
  if (!sum_.defined() || sum_.sizes() != coefficients.sizes()) {
    sum_ = torch::empty_like(coefficients, torch::MemoryFormat::Contiguous);
  }
  is_first ? sum_.copy_(coefficients) : sum_.add_(coefficients);
}

void BackgroundGradient::step_along_mean(double rate, int n_views, BackgroundState& background) {
  background.steps += n_views;
  sum_.mul_(1.0 / n_views);
  const AdamArgs args = step_args(std::sqrt(n_views) * rate, sum_, background);
  const AdamRule rule = adam_rule(n_views);
#if B3DGS_TORCH_CUDA
  if (background.coefficients.is_cuda()) return cuda::step_background(args, rule, torch_launch_context().stream);
#endif
  cpu::adam_step(args, rule);
}

}  // namespace b3dgs
