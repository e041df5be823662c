#include "train/quality/metrics.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

constexpr double kMaxPsnr = 100;  // dB, for identical images: JSON has no infinity

}  // namespace

std::optional<ImageQuality> image_quality(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) {
  const Image8 image = to_image8(rendered);
  B3DGS_CHECK(image.width == truth.width && image.height == truth.height && image.channels == 3 && truth.channels == 3,
              "rendered view is ", image.width, " x ", image.height, " px, photograph is ", truth.width, " x ",
              truth.height);
  const std::int64_t n_pixels = static_cast<std::int64_t>(image.width) * image.height;
  const std::uint8_t* mask = valid ? valid->pixels.data() : nullptr;
  B3DGS_CHECK(!valid || static_cast<std::int64_t>(valid->pixels.size()) == n_pixels, "the mask has ",
              valid->pixels.size(), " pixels, the image ", n_pixels);
  const std::int64_t n_valid = mask ? count_valid(mask, n_pixels) : n_pixels;
  if (n_valid == 0) return std::nullopt;

  std::int64_t square_sum = 0;
  std::vector<float> values(image.pixels.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = static_cast<float>(image.pixels[i]) / 255.0f;
    if (mask && mask[i / 3] == 0) continue;
    const int difference = image.pixels[i] - truth.pixels[i];
    square_sum += difference * difference;
  }
  LossArgs args;
  args.width = image.width;
  args.height = image.height;
  args.rendered = values.data();
  args.truth = truth.pixels.data();
  args.valid = mask;
  args.n_valid = n_valid;
  const double mean_square = static_cast<double>(square_sum) / (255.0 * 255.0 * 3.0 * static_cast<double>(n_valid));
  return ImageQuality{square_sum == 0 ? kMaxPsnr : -10 * std::log10(mean_square), cpu::compute_loss(args).ssim};
}

Image8 to_image8(const torch::Tensor& image) {
  B3DGS_CHECK(image.dim() == 2 || (image.dim() == 3 && image.size(2) == 3), "expected [H, W, 3] or [H, W], found ",
              image.sizes());
  const torch::Tensor host = image.to(torch::kCPU).contiguous();
  Image8 result(static_cast<int>(host.size(1)), static_cast<int>(host.size(0)), host.dim() == 2 ? 1 : 3);
  const float* values = host.data_ptr<float>();
  // NaN becomes 0, since every comparison with it is false.
  std::transform(values, values + host.numel(), result.pixels.begin(), [](float value) {
    return static_cast<std::uint8_t>(value > 0.0f ? std::lround(255.0f * std::min(value, 1.0f)) : 0);
  });
  return result;
}

}  // namespace b3dgs
