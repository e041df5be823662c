#include "train/quality/lpips.h"

#include <torch/script.h>

#include <cstring>

#include "core/check.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

/// The first line of LibTorch's text: a stack trace follows.
std::string first_line(const std::exception& error) {
  return {error.what(), std::strcspn(error.what(), "\n")};
}

/// [1, 3, H, W] float in [0, 1].
torch::Tensor to_planes(const Image8& image, const Image8* valid, torch::Device device) {
  torch::Tensor pixels =
      torch::from_blob(const_cast<std::uint8_t*>(image.pixels.data()), {image.height, image.width, 3}, torch::kUInt8)
          .to(torch::kFloat32)
          .div_(255);
  if (valid != nullptr) {
    pixels.mul_(
        torch::from_blob(const_cast<std::uint8_t*>(valid->pixels.data()), {image.height, image.width, 1}, torch::kUInt8)
            .ne(0));
  }
  return pixels.permute({2, 0, 1}).unsqueeze(0).contiguous().to(device);
}

}  // namespace

struct LpipsNetwork::Impl {
  torch::Device device;
  mutable torch::jit::Module module;
};

LpipsNetwork::LpipsNetwork(const std::filesystem::path& file, torch::Device device)
    : impl_(std::make_unique<Impl>(Impl{device, {}})), name_(file.filename().string()) {
  if (!std::filesystem::is_regular_file(file)) input_error("LPIPS network not found: ", file.string());
  try {
    impl_->module = torch::jit::load(file.string(), device);
    impl_->module.eval();
  } catch (const std::exception& error) {
    input_error(file.string(), ": expected a TorchScript network (--lpips): ", first_line(error));
  }
}
LpipsNetwork::~LpipsNetwork() = default;

double LpipsNetwork::distance(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) const {
  const torch::NoGradGuard no_grad;
  const Image8 image = to_image8(rendered);
  B3DGS_CHECK(image.width == truth.width && image.height == truth.height, "rendered view is ", image.width, " x ",
              image.height, " px, photograph is ", truth.width, " x ", truth.height);
  const std::string promise = "expected forward(a, b) of two images [1, 3, H, W] that returns one number";
  try {
    const torch::jit::IValue result =
        impl_->module.forward({to_planes(image, valid, impl_->device), to_planes(truth, valid, impl_->device)});
    if (result.isDouble()) return result.toDouble();
    if (result.isTensor() && result.toTensor().numel() == 1) return result.toTensor().item<double>();
    input_error(name_, ": ", promise, ", found ", result.tagKind());
  } catch (const InputError&) {
    throw;
  } catch (const std::exception& error) {
    input_error(name_, ": ", promise, "; LibTorch: ", first_line(error));
  }
}

}  // namespace b3dgs
