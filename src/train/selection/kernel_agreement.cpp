#include "train/selection/kernel_agreement.h"

#include <torch/types.h>

#include <algorithm>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr double kRounding = 1e-4, kFlip = 0.02;  // of the image's range
constexpr double kGradientRounding = 1e-3;        // of a column's norm

/// Pixels at which a splat may be on the other side of a threshold: one in ten thousand, and a few in small images.
std::int64_t allowed_flips(std::int64_t n_pixels) {
  return 4 + n_pixels / 10000;
}

}  // namespace

std::string image_fault(const RenderedView& image, const RenderedView& reference) {
  B3DGS_CHECK(image.color.sizes() == reference.color.sizes(), "images of ", image.color.sizes(), " and ",
              reference.color.sizes());
  if (image.alpha.numel() == 0) return "";
  const torch::Tensor difference =
      torch::maximum(torch::amax((image.color - reference.color).abs(), {2}), (image.alpha - reference.alpha).abs());
  const double range = std::max(1.0, reference.color.abs().max().item<double>());
  const auto n_off = torch::logical_not(difference <= kRounding * range).sum().item<std::int64_t>();
  const double largest = difference.max().item<double>(), most = kFlip * range;
  const std::int64_t allowed = allowed_flips(difference.numel());
  if (n_off <= allowed && largest <= most) return "";
  return detail::concat("its image differs in ", n_off, " pixels by up to ", largest, " (at most ", allowed,
                        " pixels and ", most, " can be rounding)");
}

std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference) {
  B3DGS_CHECK(sums.sizes() == reference.sizes(), "gradients of ", sums.sizes(), " and ", reference.sizes());
  const torch::Tensor off = (sums - reference).square().sum(0).sqrt(), norm = reference.square().sum(0).sqrt();
  const torch::Tensor agrees = off <= kGradientRounding * norm + 1e-30;
  if (agrees.all().item<bool>()) return "";
  const double largest = (off / (norm + 1e-30)).max().item<double>();
  return detail::concat("its gradients differ by ", largest, " of their norm (at most ", kGradientRounding,
                        " can be rounding)");
}

}  // namespace b3dgs
