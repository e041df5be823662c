// Tests colour transforms fitted to photographs, and views that are measured on their right half.
#include "train/quality/metrics.h"

#include <gtest/gtest.h>

#include <cmath>

#include "support/approx.h"
#include "support/train/tiny_scene.h"
#include "train/evaluate.h"

namespace b3dgs {
namespace {

Image8 to_photograph(const torch::Tensor& image) {
  return to_image8(image.to(torch::kFloat32));
}

constexpr ColorTransform kTint{{{0.7, 0.1, 0, 0.05}, {0, 0.8, 0.05, 0.02}, {0.1, 0, 0.6, 0.1}}};

TEST(ColorFit, FindsAnAffineTransform) {
  torch::manual_seed(1);
  const torch::Tensor rendered = torch::rand({40, 50, 3});
  const ColorTransform found = fit_colors(rendered, to_photograph(transform_colors(rendered, kTint)), nullptr);
  for (std::size_t i = 0; i < 12; ++i) {
    EXPECT_NEAR(found[i / 4][i % 4], kTint[i / 4][i % 4], 2e-3) << i;  // 8-bit rounding
  }
}

TEST(ColorFit, MinimisesTheSquaredErrorOfTheValidPixels) {
  torch::manual_seed(2);
  const torch::Tensor rendered = torch::rand({30, 20, 3});
  const Image8 truth = to_photograph(torch::rand({30, 20, 3}));
  Image8 valid(20, 30, 1);
  for (std::size_t p = 0; p < valid.pixels.size(); ++p) valid.pixels[p] = p % 3 == 0 ? 0 : 255;
  const auto error = [&](const ColorTransform& transform) {
    double sum = 0;
    for (std::int64_t p = 0; p < 600; ++p) {
      if (valid.pixels[static_cast<std::size_t>(p)] == 0) continue;
      for (std::size_t c = 0; c < 3; ++c) {
        double value = transform[c][3] - truth.pixels[static_cast<std::size_t>(3 * p) + c] / 255.0;
        for (std::int64_t k = 0; k < 3; ++k)
          value += transform[c][static_cast<std::size_t>(k)] * rendered.view({-1, 3})[p][k].item<double>();
        sum += value * value;
      }
    }
    return sum;
  };
  ColorTransform best = fit_colors(rendered, truth, &valid);
  const double least = error(best);
  EXPECT_LT(least, 0.8 * error(kSameColors));
  for (std::size_t i = 0; i < 12; ++i) {
    double& element = best[i / 4][i % 4];
    for (const double change : {-0.01, 0.01}) {
      element += change;
      EXPECT_GT(error(best), least);
      element -= change;
    }
  }
}

TEST(ColorFit, ChangesNothingThatTheImagesDoNotDecide) {
  const torch::Tensor gray = torch::full({8, 8, 3}, 0.5f);
  EXPECT_TRUE(test::within(transform_colors(gray, fit_colors(gray, to_photograph(gray * 0.8), nullptr)),
                           torch::full({8, 8, 3}, 0.4f), 1e-3))
      << "an image of one colour";
  const Image8 none(8, 8, 1);
  EXPECT_EQ(fit_colors(gray, to_photograph(gray * 0.8), &none), kSameColors);
}

TEST(ColorFit, ColumnsOfAMask) {
  Image8 mask(4, 2, 1);
  mask.pixels = {255, 0, 255, 255, 255, 255, 0, 255};
  EXPECT_EQ(valid_in_columns(4, 2, &mask, 2, 4).pixels, (std::vector<std::uint8_t>{0, 0, 255, 255, 0, 0, 0, 255}));
  EXPECT_EQ(valid_in_columns(4, 1, nullptr, 0, 2).pixels, (std::vector<std::uint8_t>{255, 255, 0, 0}));
}

class Evaluated : public testing::Test {
 protected:
  /// A test view whose photograph is the render in other colours; the left fifth is wrong if `is_masked`.
  View photograph(bool is_masked = false) {
    View view = scene_.test[0];
    const torch::Tensor color = rasterizer_.forward(gaussians_, to_camera_view(view.camera), {}).color;
    Image8 image = to_photograph(transform_colors(color, kTint));
    if (is_masked) {
      auto valid = std::make_shared<Image8>(valid_in_columns(image.width, image.height, nullptr, 12, image.width));
      for (std::size_t i = 0; i < image.pixels.size(); ++i) {
        if (valid->pixels[i / 3] == 0) image.pixels[i] = 255;
      }
      view.valid = valid;
    }
    view.image = std::make_shared<ViewImage>(std::move(image));
    return view;
  }
  ImageQuality quality(const View& view, const ColorEvaluation& colors) {
    return evaluate_views(rasterizer_, gaussians_, {view}, {}, {}, nullptr, colors).mean;
  }

  const Scene scene_ = test::make_tiny_scene();
  const GaussianTensors gaussians_ = to_tensors(splats_from_points(scene_.points, 0), 0, torch::kCPU);
  Rasterizer rasterizer_{torch::kCPU};
};

TEST_F(Evaluated, WithColoursFittedToTheLeftHalf) {
  ColorEvaluation colors;
  colors.fit_left_half = true;
  for (const bool is_masked : {false, true}) {
    View view = photograph(is_masked);
    EXPECT_LT(quality(view, {}).psnr, 32) << "other colours";
    EXPECT_GT(quality(view, colors).psnr, 45);
    // An error in the left half affects the fit, and an error in the right half is measured. Neither hides the other.
    Image8 spoiled = *view.image->read();
    const int x = spoiled.width - 1;
    for (int y = 0; y < spoiled.height; ++y) {
      for (int c = 0; c < 3; ++c) spoiled.pixels[static_cast<std::size_t>(3 * (y * spoiled.width + x) + c)] = 255;
    }
    view.image = std::make_shared<ViewImage>(std::move(spoiled));
    EXPECT_LT(quality(view, colors).psnr, 25);
  }
}

TEST_F(Evaluated, OnlyTheRightHalfIsMeasured) {
  View view = photograph();
  Image8 image = *view.image->read();
  // The left half has the colours of the render, so the fit changes nothing, and the right half has other colours.
  const Image8 own =
      to_photograph(rasterizer_.forward(gaussians_, to_camera_view(view.camera), RenderSettings{}).color);
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width / 2; ++x) {
      for (int c = 0; c < 3; ++c) {
        const auto i = static_cast<std::size_t>(3 * (y * image.width + x) + c);
        image.pixels[i] = own.pixels[i];
      }
    }
  }
  view.image = std::make_shared<ViewImage>(std::move(image));
  const Image8 right = valid_in_columns(own.width, own.height, nullptr, own.width / 2, own.width);
  view.valid = std::make_shared<Image8>(right);
  const double of_right = quality(view, {}).psnr;
  view.valid = nullptr;
  ColorEvaluation colors;
  colors.fit_left_half = true;
  EXPECT_NEAR(quality(view, colors).psnr, of_right, 0.2);
  EXPECT_GT(quality(view, {}).psnr, of_right + 2);
}

// This is the case with --train_test_exp and a mask over the right half.
TEST_F(Evaluated, AViewWithoutValidPixelsIsNotInTheMean) {
  View hidden = photograph();
  const Camera& camera = hidden.camera;
  hidden.name = "hidden.png";
  hidden.valid = std::make_shared<Image8>(valid_in_columns(camera.width, camera.height, nullptr, 0, camera.width / 2));
  ColorEvaluation colors;
  colors.fit_left_half = colors.corrected_psnr = true;
  std::vector<std::string> without;
  const Evaluation evaluation = evaluate_views(
      rasterizer_, gaussians_, {photograph(), hidden}, {},
      [&](std::size_t, const View& view, const RenderedView&, const std::optional<ImageQuality>& measured) {
        if (!measured) without.push_back(view.name);
      },
      nullptr, colors);
  const ImageQuality expected = quality(photograph(), colors);
  EXPECT_EQ(evaluation.mean.psnr, expected.psnr);
  EXPECT_EQ(evaluation.mean.ssim, expected.ssim);
  EXPECT_EQ(evaluation.mean.corrected_psnr.value(), expected.corrected_psnr.value());
  EXPECT_EQ(evaluation.views.size(), 1u);
  EXPECT_EQ(evaluation.unmeasured, (std::vector<std::string>{"hidden.png"}));
  EXPECT_EQ(without, evaluation.unmeasured);
  const std::string text = describe_quality(30, evaluation);
  EXPECT_EQ(text.find("iteration 30: PSNR "), 0u) << text;
  EXPECT_NE(text.find(" on the right half of 1 test views; 1 without a valid pixel (first: hidden.png)"),
            std::string::npos)
      << text;
}

TEST_F(Evaluated, WithKnownExposuresAndCorrectedBesideRaw) {
  const View view = photograph();
  ColorEvaluation colors;
  colors.corrected_psnr = true;
  const ImageQuality raw = quality(view, colors);
  EXPECT_LT(raw.psnr, 32);
  EXPECT_GT(raw.corrected_psnr.value(), 45);
  colors.exposures = {{view.name, kTint}};
  colors.fit_left_half = true;  // has no effect on a view with a known exposure
  const ImageQuality known = quality(view, colors);
  EXPECT_GT(known.psnr, 45);
  EXPECT_EQ(known.corrected_psnr.value(), raw.corrected_psnr.value()) << "the fit starts from the raw render";
  EXPECT_FALSE(quality(view, {}).corrected_psnr.has_value());
}

}  // namespace
}  // namespace b3dgs
