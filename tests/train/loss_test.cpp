// Compares the loss with a reference implementation in double that sums the 121 taps of each window directly.

#include "train/loss/loss.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>

#include "core/parallel.h"
#include "support/approx.h"
#include "support/finite_difference.h"
#include "train/loss/loss_args.h"

namespace b3dgs {
namespace {

struct Images {
  int width, height;
  std::vector<double> rendered;
  std::vector<std::uint8_t> truth;
  std::vector<std::uint8_t> valid;  // empty = all
};

Images make_images(int width, int height, bool masked) {
  std::mt19937 engine(static_cast<unsigned>(width * 1000 + height));
  std::uniform_real_distribution<double> uniform(-0.2, 1.2);  // beyond [0, 1], because renders are not clamped
  Images images{width, height, {}, {}, {}};
  for (int i = 0; i < width * height * 3; ++i) {
    images.rendered.push_back(static_cast<float>(uniform(engine)));
    images.truth.push_back(static_cast<std::uint8_t>(engine() % 256));
  }
  for (int i = 0; masked && i < width * height; ++i) images.valid.push_back(engine() % 3 == 0 ? 0 : 255);
  return images;
}

std::int64_t n_valid(const Images& images) {
  const std::int64_t n = static_cast<std::int64_t>(images.width) * images.height;
  return images.valid.empty() ? n : count_valid(images.valid.data(), n);
}

LossValue naive_loss(const Images& images, double lambda) {
  double window[11][11], window_sum = 0;
  for (int i = 0; i < 11; ++i) {
    for (int j = 0; j < 11; ++j) {
      window[i][j] = std::exp(-((i - 5) * (i - 5) + (j - 5) * (j - 5)) / (2 * 1.5 * 1.5));
      window_sum += window[i][j];
    }
  }
  const auto is_valid = [&](int row, int column) {
    if (row < 0 || column < 0 || row >= images.height || column >= images.width) return false;
    return images.valid.empty() || images.valid[row * images.width + column] != 0;
  };
  LossValue value;
  for (int row = 0; row < images.height; ++row) {
    for (int column = 0; column < images.width; ++column) {
      if (!is_valid(row, column)) continue;
      for (int channel = 0; channel < 3; ++channel) {
        double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
        for (int i = 0; i < 11; ++i) {
          for (int j = 0; j < 11; ++j) {
            const int r = row + i - 5, c = column + j - 5;
            if (!is_valid(r, c)) continue;
            const double x = images.rendered[(r * images.width + c) * 3 + channel];
            const double y = images.truth[(r * images.width + c) * 3 + channel] / 255.0;
            const double w = window[i][j] / window_sum;
            mx += w * x;
            my += w * y;
            xx += w * x * x;
            yy += w * y * y;
            xy += w * x * y;
          }
        }
        const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
        value.ssim += (2 * mx * my + c1) * (2 * (xy - mx * my) + c2) /
                      ((mx * mx + my * my + c1) * (xx - mx * mx + yy - my * my + c2));
        const int index = (row * images.width + column) * 3 + channel;
        value.l1 += std::abs(images.rendered[index] - images.truth[index] / 255.0);
      }
    }
  }
  value.l1 /= 3.0 * n_valid(images);
  value.ssim /= 3.0 * n_valid(images);
  value.loss = (1 - lambda) * value.l1 + lambda * (1 - value.ssim);
  return value;
}

struct FusedLoss {
  LossValue value;
  std::vector<float> grad;
};

FusedLoss fused_loss(const Images& images, double lambda) {
  const std::vector<float> rendered(images.rendered.begin(), images.rendered.end());
  FusedLoss result;
  result.grad.assign(rendered.size(), NAN);
  std::vector<float> workspace(cpu::loss_workspace_size(images.width, images.height) + 16);
  LossArgs args;
  args.width = images.width;
  args.height = images.height;
  args.rendered = rendered.data();
  args.truth = images.truth.data();
  args.valid = images.valid.empty() ? nullptr : images.valid.data();
  args.n_valid = n_valid(images);
  args.weights.dssim = lambda;
  args.grad = result.grad.data();
  args.workspace = workspace.data() + (16 - reinterpret_cast<std::uintptr_t>(workspace.data()) / 4 % 16) % 16;
  result.value = cpu::compute_loss(args);
  args.grad = nullptr;
  args.workspace = nullptr;
  const double value_alone = cpu::compute_loss(args).loss;
  EXPECT_EQ(std::memcmp(&value_alone, &result.value.loss, sizeof value_alone), 0)
      << "the value depends on whether a gradient is computed";
  return result;
}

TEST(SsimWindow, IsANormalisedGaussian) {
  double sum = 0;
  for (int d = -5; d <= 5; ++d) sum += std::exp(-d * d / (2 * 1.5 * 1.5));
  for (int d = 0; d <= 5; ++d) {
    EXPECT_FLOAT_EQ(ssim_weight(d), static_cast<float>(std::exp(-d * d / (2 * 1.5 * 1.5)) / sum)) << d;
  }
}

struct Case {
  int width, height;
  bool masked;
};

class LossOfSize : public testing::TestWithParam<Case> {};

TEST_P(LossOfSize, ValueMatchesTheReference) {
  const Images images = make_images(GetParam().width, GetParam().height, GetParam().masked);
  const LossValue naive = naive_loss(images, 0.2), fused = fused_loss(images, 0.2).value;
  EXPECT_NEAR(fused.l1, naive.l1, 1e-6);
  EXPECT_NEAR(fused.ssim, naive.ssim, 1e-6);
  EXPECT_NEAR(fused.loss, naive.loss, 1e-6);
}

TEST_P(LossOfSize, GradientMatchesFiniteDifferences) {
  const Images images = make_images(GetParam().width, GetParam().height, GetParam().masked);
  for (const double dssim : {0.0, 0.2, 1.0}) {
    SCOPED_TRACE(testing::Message() << "D-SSIM " << dssim);
    const std::vector<double> numeric = test::numeric_gradient(
        [&](const std::vector<double>& x) {
          Images moved = images;
          moved.rendered = x;
          return naive_loss(moved, dssim).loss;
        },
        images.rendered, 1e-5);
    const FusedLoss fused = fused_loss(images, dssim);
    EXPECT_TRUE(test::gradients_agree({fused.grad.begin(), fused.grad.end()}, numeric, 1e-5));
  }
}

// Images smaller than the window, of odd size, with one row, with one column, and wider than a vector.
INSTANTIATE_TEST_SUITE_P(Sizes, LossOfSize,
                         testing::Values(Case{1, 1, false}, Case{7, 3, false}, Case{3, 14, false}, Case{19, 1, false},
                                         Case{17, 13, false}, Case{7, 3, true}, Case{17, 13, true}, Case{3, 40, true}));

TEST(Loss, OfEqualImagesIsZeroAndHasNoGradient) {
  Images images = make_images(40, 30, false);
  for (std::size_t i = 0; i < images.truth.size(); ++i) images.rendered[i] = images.truth[i] / 255.0f;
  const FusedLoss fused = fused_loss(images, 0.2);
  EXPECT_EQ(fused.value.l1, 0);
  EXPECT_NEAR(fused.value.ssim, 1, 1e-6);
  for (const float g : fused.grad) ASSERT_NEAR(g, 0, 1e-7);
}

TEST(Loss, IgnoresMaskedPixels) {
  Images images = make_images(33, 21, true);
  const FusedLoss before = fused_loss(images, 0.2);
  for (std::size_t i = 0; i < images.rendered.size(); ++i) {
    if (images.valid[i / 3] != 0) continue;
    EXPECT_EQ(before.grad[i], 0) << i;
    images.rendered[i] = i % 2 == 0 ? NAN : 1e9;
    images.truth[i] = static_cast<std::uint8_t>(255 - images.truth[i]);
  }
  const FusedLoss after = fused_loss(images, 0.2);
  EXPECT_EQ(after.value.loss, before.value.loss);
  EXPECT_EQ(after.grad, before.grad);
}

TEST(Loss, WithoutAnyValidPixelIsZero) {
  Images images = make_images(9, 9, true);
  images.valid.assign(images.valid.size(), 0);
  const FusedLoss fused = fused_loss(images, 0.2);
  EXPECT_EQ(fused.value.loss, 0);
  for (const float g : fused.grad) ASSERT_EQ(g, 0);
}

TEST(Loss, IsTheSameForAnyNumberOfThreads) {
  const Images images = make_images(61, 150, true);  // several bands
  set_thread_count(1);
  const FusedLoss one = fused_loss(images, 0.2);
  for (const int threads : {2, 3, 7}) {
    set_thread_count(threads);
    const FusedLoss several = fused_loss(images, 0.2);
    EXPECT_EQ(several.value.loss, one.value.loss) << threads;
    EXPECT_EQ(several.grad, one.grad) << threads;
  }
  set_thread_count(0);
}

TEST(Loss, IsNotFiniteIfAPixelIsNot) {
  Images images = make_images(30, 30, false);
  images.rendered[1234] = NAN;
  EXPECT_FALSE(std::isfinite(fused_loss(images, 0.2).value.loss));
}

TEST(Loss, IsTheSameOnTensors) {
  const Images images = make_images(23, 17, true);
  const FusedLoss expected = fused_loss(images, 0.2);
  const std::vector<float> rendered(images.rendered.begin(), images.rendered.end());
  const auto tensor = [&](const auto& values, torch::IntArrayRef sizes, torch::ScalarType type) {
    return torch::from_blob(const_cast<void*>(static_cast<const void*>(values.data())), sizes, type).clone();
  };
  ImageLoss loss(torch::kCPU);
  loss.compute(tensor(rendered, {17, 23, 3}, torch::kFloat32), tensor(images.truth, {17, 23, 3}, torch::kUInt8),
               tensor(images.valid, {17, 23}, torch::kUInt8), n_valid(images), LossWeights{0.2});
  EXPECT_EQ(loss.value().loss, expected.value.loss);
  EXPECT_TRUE(test::same(loss.grad().color, tensor(expected.grad, {17, 23, 3}, torch::kFloat32)));
}

// Compares the value with its formula, and the gradient with finite differences of the formula.
TEST(Loss, AlphaOfEmptyPixelsIsATermOfItsOwn) {
  constexpr std::int64_t kHeight = 5, kWidth = 7;
  const torch::Tensor rendered = torch::full({kHeight, kWidth, 3}, 0.5f);
  const torch::Tensor truth = torch::full({kHeight, kWidth, 3}, 128, torch::kUInt8);
  torch::Tensor alpha = torch::arange(kHeight * kWidth, torch::kFloat32).reshape({kHeight, kWidth}) / 64;
  const torch::Tensor empty =
      (torch::arange(kHeight * kWidth) % 3 == 0).to(torch::kUInt8).reshape({kHeight, kWidth}) * 255;
  ImageLoss loss(torch::kCPU);
  const auto value = [&] {
    loss.compute(rendered, truth, {}, kHeight * kWidth, LossWeights{0.2});
    loss.add_alpha(alpha, empty, 0.75);
    return loss.value().loss;
  };
  loss.compute(rendered, truth, {}, kHeight * kWidth, LossWeights{0.2});
  const double without = loss.value().loss;
  EXPECT_FALSE(loss.grad().alpha.defined());
  double sum = 0;
  for (std::int64_t i = 0; i < kHeight * kWidth; i += 3) sum += alpha.flatten()[i].item<double>();
  EXPECT_NEAR(value() - without, 0.75 * sum / (kHeight * kWidth), 1e-7);
  const torch::Tensor grad = loss.grad().alpha.clone();
  for (const std::int64_t i : {0, 1, 3, 17, 33, 34}) {
    float& entry = alpha.data_ptr<float>()[i];
    const float at = entry, step = 0.25f;
    entry = at + step;
    const double above = value();
    entry = at - step;
    const double below = value();
    entry = at;
    EXPECT_NEAR(grad.flatten()[i].item<double>(), (above - below) / (2 * step), 1e-7) << i;
  }
}

}  // namespace
}  // namespace b3dgs
