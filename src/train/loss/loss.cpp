// Converts tensors to LossArgs.

#include "train/loss/loss.h"

#include <algorithm>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"

namespace b3dgs {

std::int64_t count_valid(const std::uint8_t* valid, std::int64_t n_pixels) {
  return n_pixels - std::count(valid, valid + n_pixels, std::uint8_t{0});
}

namespace {

void check_images(torch::Device device, const torch::Tensor& rendered, const torch::Tensor& truth,
                  const torch::Tensor& valid) {
  TensorCheck check(device);
  check.dims("rendered", rendered, {"H", "W", 3});
  check.dims("truth", truth, {"H", "W", 3}, torch::kUInt8);
  if (valid.defined()) check.dims("valid", valid, {"H", "W"}, torch::kUInt8);
}

}  // namespace

ImageLoss::ImageLoss(torch::Device device) : device_(device) {
  if constexpr (kTorchHasCuda) {
    if (device.is_cpu()) return;
    host_value_.emplace(sizeof(LossValue));
  }
}

LossValue ImageLoss::value() const {
  LossValue value = value_;
  if (kTorchHasCuda && host_value_) value = *static_cast<const LossValue*>(host_value_->wait());
  if (alpha_value_.defined()) value.loss += alpha_value_.item<double>();
  return value;
}

void ImageLoss::add_alpha(const torch::Tensor& alpha, const torch::Tensor& empty, double weight) {
  TensorCheck check(device_);
  check.dims("alpha", alpha, {"H", "W"});
  check.dims("empty", empty, {"H", "W"}, torch::kUInt8);
  place_tensor(alpha_grad_, alpha_grad_room_, alpha.sizes(), alpha.options());
  alpha_grad_.copy_(empty).mul_(weight / (255.0 * static_cast<double>(alpha.numel())));
  if (device_.is_cpu()) {
    // Sums in a fixed order, so that the value does not depend on the number of threads.
    const float *alphas = alpha.data_ptr<float>(), *weights = alpha_grad_.data_ptr<float>();
    double sum = 0;
    for (std::int64_t i = 0; i < alpha.numel(); ++i) sum += double{alphas[i]} * weights[i];
    alpha_value_ = torch::full({}, sum, torch::kFloat64);
  } else {
    alpha_value_ = torch::dot(alpha.reshape({-1}), alpha_grad_.reshape({-1}));
  }
}

void ImageLoss::compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid,
                        std::int64_t n_valid, const LossWeights& weights) {
  check_images(device_, rendered, truth, valid);
  alpha_grad_ = alpha_value_ = torch::Tensor();
  LossArgs args;
  args.height = static_cast<std::int32_t>(rendered.size(0));
  args.width = static_cast<std::int32_t>(rendered.size(1));
  std::int64_t workspace_size = cpu::loss_workspace_size(args.width, args.height);
  if (kTorchHasCuda && device_.is_cuda()) workspace_size = cuda::loss_workspace_size(args.width, args.height);
  place_tensor(grad_, grad_room_, rendered.sizes(), rendered.options());
  if (!workspace_.defined() || workspace_.numel() < workspace_size) {
    workspace_ = torch::empty({workspace_size}, rendered.options());
  }
  args.rendered = rendered.data_ptr<float>();
  args.truth = truth.data_ptr<std::uint8_t>();
  args.valid = data_or_null<std::uint8_t>(valid);
  args.n_valid = n_valid;
  args.weights = weights;
  args.grad = grad_.data_ptr<float>();
  args.workspace = workspace_.data_ptr<float>();
  if (kTorchHasCuda && host_value_) {
    cuda::compute_loss(args, static_cast<LossValue*>(host_value_->memory()), torch_stream());
    host_value_->mark();
  } else {
    value_ = cpu::compute_loss(args);
  }
}

void ErrorImage::compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid) {
  check_images(rendered.device(), rendered, truth, valid);
  place_tensor(error_, room_, rendered.sizes().slice(0, 2), rendered.options());
  ErrorImageArgs args;
  args.rendered = rendered.data_ptr<float>();
  args.truth = truth.data_ptr<std::uint8_t>();
  args.valid = data_or_null<std::uint8_t>(valid);
  args.error = error_.data_ptr<float>();
  for_rows<write_pixel_error>(rendered.is_cuda(), args, error_.numel());
}

}  // namespace b3dgs
