// Converts tensors to LossArgs.

#include "train/loss/loss.h"

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {

std::int64_t count_valid(const std::uint8_t* valid, std::int64_t n_pixels) {
  std::int64_t count = 0;
  for (std::int64_t i = 0; i < n_pixels; ++i) count += valid[i] != 0;
  return count;
}

ImageLoss::ImageLoss(torch::Device device) : device_(device) {
  if (device.is_cpu()) return;
  if (!kTorchHasCuda) {
    input_error("this build computes the loss on the CPU only, found device ", device.str(), "; use --device cpu");
  }
  if (kTorchHasCuda) host_value_ = make_host_copy(sizeof(LossValue));
}

ImageLoss::~ImageLoss() = default;

LossValue ImageLoss::value() const {
  LossValue value = host_value_ ? *static_cast<const LossValue*>(host_value_->wait()) : value_;
  if (alpha_value_.defined()) value.loss += alpha_value_.item<double>();
  return value;
}

void ImageLoss::add_alpha(const torch::Tensor& alpha, const torch::Tensor& empty, double weight) {
  TensorCheck(device_).dims("alpha", alpha, {"H", "W"});
  B3DGS_CHECK(empty.scalar_type() == torch::kUInt8 && empty.sizes() == alpha.sizes() && empty.device() == device_,
              "empty is not uint8 of the size of the rendered view, ", alpha.sizes(), ", on ", device_.str());
  place_tensor(alpha_grad_, alpha_grad_room_, alpha.sizes(), alpha.options());
  alpha_grad_.copy_(empty).mul_(weight / (255.0 * static_cast<double>(alpha.numel())));
  if (device_.is_cpu()) {
    // In one order, so that the value does not depend on the number of threads.
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
  TensorCheck(device_).dims("rendered", rendered, {"H", "W", 3});
  const auto check_bytes = [&](const char* name, const torch::Tensor& bytes, torch::IntArrayRef sizes) {
    B3DGS_CHECK(bytes.defined() && bytes.sizes() == sizes, name, " does not have the size of the rendered view, ",
                rendered.sizes());
    B3DGS_CHECK(bytes.scalar_type() == torch::kUInt8 && bytes.is_contiguous() && bytes.device() == device_, name,
                " is not contiguous uint8 on ", device_.str());
  };
  check_bytes("truth", truth, rendered.sizes());
  if (valid.defined()) check_bytes("valid", valid, rendered.sizes().slice(0, 2));

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
  args.valid = valid.defined() ? valid.data_ptr<std::uint8_t>() : nullptr;
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
  TensorCheck(rendered.device()).dims("rendered", rendered, {"H", "W", 3});
  B3DGS_CHECK(truth.sizes() == rendered.sizes() && truth.scalar_type() == torch::kUInt8 && truth.is_contiguous(),
              "truth is ", truth.sizes(), " ", truth.scalar_type(), ", expected contiguous uint8 ", rendered.sizes());
  place_tensor(error_, room_, rendered.sizes().slice(0, 2), rendered.options());
  ErrorImageArgs args;
  args.n_pixels = error_.numel();
  args.rendered = rendered.data_ptr<float>();
  args.truth = truth.data_ptr<std::uint8_t>();
  args.valid = valid.defined() ? valid.data_ptr<std::uint8_t>() : nullptr;
  args.error = error_.data_ptr<float>();
  for_rows<write_pixel_error>(rendered.is_cuda(), args, args.n_pixels);
}

}  // namespace b3dgs
