#include "train/quality/metrics.h"

#include <torch/script.h>

#include <algorithm>
#include <cmath>
#include <tuple>

#include "core/check.h"
#include "core/text.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

/// Returns the sum of |Laplacian|, in 1/255. `mask` may be null.
std::int64_t laplacian_sum(const Image8& image, const std::uint8_t* mask) {
  const std::int64_t columns = image.width;
  std::int64_t total = 0;
  for (std::int64_t y = 1; y + 1 < image.height; ++y) {
    for (std::int64_t x = 1; x + 1 < columns; ++x) {
      const std::int64_t p = y * columns + x;
      const std::array<std::int64_t, 4> around{p - 1, p + 1, p - columns, p + columns};
      const auto is_invalid = [&](std::int64_t at) { return mask != nullptr && mask[at] == 0; };
      if (is_invalid(p) || std::any_of(around.begin(), around.end(), is_invalid)) continue;
      const auto gray = [&](std::int64_t at) {
        const std::uint8_t* const rgb = image.pixels.data() + 3 * at;
        return rgb[0] + rgb[1] + rgb[2];
      };
      total += std::abs(gray(p - 1) + gray(p + 1) + gray(p - columns) + gray(p + columns) - 4 * gray(p));
    }
  }
  return total;
}

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
  constexpr double kMaxPsnr = 100;  // dB, for identical images, because JSON has no infinity
  const double mean_square = static_cast<double>(square_sum) / (255.0 * 255.0 * 3.0 * static_cast<double>(n_valid));
  const std::int64_t contrast = laplacian_sum(truth, mask);
  ImageQuality quality;
  quality.psnr = square_sum == 0 ? kMaxPsnr : -10 * std::log10(mean_square);
  quality.ssim = cpu::compute_loss(args).ssim;
  quality.sharpness =
      contrast > 0 ? static_cast<double>(laplacian_sum(image, mask)) / static_cast<double>(contrast) : 1;
  return quality;
}

Image8 to_image8(const torch::Tensor& image) {
  B3DGS_CHECK(image.dim() == 2 || (image.dim() == 3 && image.size(2) == 3), "expected [H, W, 3] or [H, W], found ",
              image.sizes());
  Image8 result(static_cast<int>(image.size(1)), static_cast<int>(image.size(0)), image.dim() == 2 ? 1 : 3);
  torch::Tensor value = torch::nan_to_num(image, 0).clamp_(0, 1).mul_(255);
  const torch::Tensor whole = value.floor();
  // Not round(), which rounds 126.5 to 126.
  const torch::Tensor bytes = host_copy(value.sub_(whole).ge_(0.5).add_(whole).to(torch::kUInt8).contiguous());
  std::copy_n(bytes.data_ptr<std::uint8_t>(), bytes.numel(), result.pixels.begin());
  return result;
}

torch::Tensor host_copy(const torch::Tensor& tensor) {
  torch::Tensor host =
      torch::empty(tensor.sizes(), torch::TensorOptions().dtype(tensor.scalar_type()).pinned_memory(tensor.is_cuda()));
  return host.copy_(tensor);
}

namespace {

/// Returns the image as [1, 3, H, W] float in [0, 1].
torch::Tensor to_planes(const Image8& image, const Image8* valid, torch::Device device) {
  const auto bytes_of = [](const Image8& of) {
    return torch::from_blob(const_cast<std::uint8_t*>(of.pixels.data()), {of.height, of.width, of.channels},
                            torch::kUInt8);
  };
  torch::Tensor pixels = bytes_of(image).to(torch::kFloat32).div_(255);
  if (valid != nullptr) pixels.mul_(bytes_of(*valid).ne(0));
  return pixels.permute({2, 0, 1}).unsqueeze(0).contiguous().to(device);
}

}  // namespace

LpipsNetwork::LpipsNetwork(const std::filesystem::path& file, torch::Device device)
    : device_(device), name_(file.filename().string()) {
  if (!std::filesystem::is_regular_file(file)) input_error("LPIPS network not found: ", file.string());
  try {
    module_ = std::make_shared<torch::jit::Module>(torch::jit::load(file.string(), device));
    module_->eval();
  } catch (const std::exception& error) {
    input_error(file.string(), ": expected a TorchScript network (--lpips): ", first_line(error.what()));
  }
}

double LpipsNetwork::distance(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) const {
  const torch::NoGradGuard no_grad;
  const Image8 image = to_image8(rendered);
  B3DGS_CHECK(image.width == truth.width && image.height == truth.height, "rendered view is ", image.width, " x ",
              image.height, " px, photograph is ", truth.width, " x ", truth.height);
  const std::string promise = "expected forward(a, b) of two images [1, 3, H, W] that returns one number";
  try {
    const torch::jit::IValue result =
        module_->forward({to_planes(image, valid, device_), to_planes(truth, valid, device_)});
    if (result.isDouble()) return result.toDouble();
    if (result.isTensor() && result.toTensor().numel() == 1) return result.toTensor().item<double>();
    input_error(name_, ": ", promise, ", found ", result.tagKind());
  } catch (const InputError&) {
    throw;
  } catch (const std::exception& error) {
    input_error(name_, ": ", promise, "; LibTorch: ", first_line(error.what()));
  }
}

ColorTransform fit_colors(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) {
  const torch::Tensor host = rendered.to(torch::kCPU).contiguous();
  B3DGS_CHECK(host.dim() == 3 && host.size(0) == truth.height && host.size(1) == truth.width && host.size(2) == 3 &&
                  truth.channels == 3,
              "rendered view is ", host.sizes(), ", photograph is ", truth.width, " x ", truth.height, " px");
  const float* colors = host.data_ptr<float>();
  const std::size_t n_pixels = truth.pixels.size() / 3;
  // Normal equations of the difference from kSameColors.
  std::array<std::array<double, 4>, 4> products{};
  ColorTransform sides{};
  double n_valid = 0;
  for (std::size_t p = 0; p < n_pixels; ++p) {
    if (valid != nullptr && valid->pixels[p] == 0) continue;
    const std::array<double, 4> color{colors[3 * p], colors[3 * p + 1], colors[3 * p + 2], 1};
    for (std::size_t i = 0; i < 4; ++i) {
      for (std::size_t k = 0; k < 4; ++k) products[i][k] += color[i] * color[k];
    }
    for (std::size_t c = 0; c < 3; ++c) {
      const double difference = truth.pixels[3 * p + c] / 255.0 - color[c];
      for (std::size_t i = 0; i < 4; ++i) sides[c][i] += difference * color[i];
    }
    n_valid += 1;
  }
  if (n_valid == 0) return kSameColors;
  constexpr double kRidge = 1e-6;
  const torch::Tensor matrix = torch::from_blob(products.data(), {4, 4}, torch::kFloat64) / n_valid;
  // linalg_solve() would throw if a render that diverged makes the matrix singular.
  const torch::Tensor added =
      std::get<0>(torch::linalg_solve_ex(matrix + kRidge * torch::eye(4, torch::kFloat64),
                                         torch::from_blob(sides.data(), {3, 4}, torch::kFloat64).t() / n_valid));
  ColorTransform transform = kSameColors;
  torch::from_blob(transform.data(), {3, 4}, torch::kFloat64).add_(added.t());
  return transform;
}

torch::Tensor transform_colors(const torch::Tensor& rendered, const ColorTransform& transform) {
  const torch::Tensor matrix = torch::from_blob(const_cast<double*>(transform[0].data()), {3, 4}, torch::kFloat64)
                                   .to(rendered.device(), torch::kFloat32);
  // Uses sums of products instead of matmul, which may round its inputs on a GPU.
  torch::Tensor sum = matrix.select(1, 3).expand(rendered.sizes());
  for (int i = 0; i < 3; ++i) sum = sum + rendered.slice(2, i, i + 1) * matrix.select(1, i);
  return sum.contiguous();
}

Image8 valid_in_columns(int width, int height, const Image8* valid, int begin, int end) {
  Image8 result(width, height, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = begin; x < end; ++x) {
      const std::size_t p = static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
      result.pixels[p] = valid == nullptr || valid->pixels[p] != 0 ? 255 : 0;
    }
  }
  return result;
}

}  // namespace b3dgs
