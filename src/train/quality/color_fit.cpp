#include "train/quality/color_fit.h"

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr double kRidge = 1e-6;

using Matrix4 = std::array<std::array<double, 4>, 4>;

/// Replaces each of `sides` by the solution of matrix x = side. `matrix` is symmetric and positive definite.
void solve(Matrix4 matrix, std::array<std::array<double, 4>, 3>& sides) {
  for (std::size_t i = 0; i < 4; ++i) {  // Gaussian elimination; without pivoting, as the matrix is positive definite
    for (std::size_t row = i + 1; row < 4; ++row) {
      const double factor = matrix[row][i] / matrix[i][i];
      for (std::size_t k = i; k < 4; ++k) matrix[row][k] -= factor * matrix[i][k];
      for (auto& side : sides) side[row] -= factor * side[i];
    }
  }
  for (auto& side : sides) {
    for (std::size_t i = 4; i-- > 0;) {
      for (std::size_t k = i + 1; k < 4; ++k) side[i] -= matrix[i][k] * side[k];
      side[i] /= matrix[i][i];
    }
  }
}

}  // namespace

ColorTransform fit_colors(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) {
  const torch::Tensor host = rendered.to(torch::kCPU).contiguous();
  B3DGS_CHECK(host.dim() == 3 && host.size(0) == truth.height && host.size(1) == truth.width && host.size(2) == 3 &&
                  truth.channels == 3,
              "rendered view is ", host.sizes(), ", photograph is ", truth.width, " x ", truth.height, " px");
  const float* colors = host.data_ptr<float>();
  const std::size_t n_pixels = truth.pixels.size() / 3;
  // Normal equations of what is to be added to kSameColors.
  Matrix4 products{};
  std::array<std::array<double, 4>, 3> sides{};
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
  for (std::size_t i = 0; i < 4; ++i) {
    for (double& product : products[i]) product /= n_valid;
    for (auto& side : sides) side[i] /= n_valid;
    products[i][i] += kRidge;
  }
  solve(products, sides);
  ColorTransform transform = kSameColors;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t i = 0; i < 4; ++i) transform[4 * c + i] += sides[c][i];
  }
  return transform;
}

torch::Tensor transform_colors(const torch::Tensor& rendered, const ColorTransform& transform) {
  const torch::Tensor matrix = torch::tensor(std::vector<double>(transform.begin(), transform.end()), torch::kFloat32)
                                   .to(rendered.device())
                                   .view({3, 4});
  // Sums of products, not matmul, which may round inputs on a GPU.
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
