// Tests training from coarse to fine (--coarse_scale), and the reduction of photographs, masks and cameras.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include "config/coarse_schedule.h"
#include "core/parallel.h"
#include "core/random.h"
#include "model/raster_input.h"
#include "support/approx.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/training_views.h"

namespace b3dgs {
namespace {

using test::train;

struct Photograph {
  Image8 rgb, mask;
};

/// Returns random values with a mask, where about a third of the pixels is invalid.
Photograph make_photograph(int width, int height) {
  Photograph photograph{Image8(width, height, 3), Image8(width, height, 1)};
  const RandomKey key{3, RandomStream::kSplit, 0};
  for (std::size_t p = 0; p < photograph.mask.pixels.size(); ++p) {
    const auto random = random_uniform(key, p);
    for (std::size_t c = 0; c < 3; ++c) photograph.rgb.pixels[3 * p + c] = static_cast<std::uint8_t>(256 * random[c]);
    photograph.mask.pixels[p] = random[3] < 0.35f ? 0 : 255;
  }
  return photograph;
}

TrainView make_view(const Photograph& photograph, bool is_masked) {
  const std::int64_t width = photograph.rgb.width, height = photograph.rgb.height;
  const auto tensor = [](const Image8& image, torch::IntArrayRef sizes) {
    return torch::from_blob(const_cast<std::uint8_t*>(image.pixels.data()), sizes, torch::kUInt8);
  };
  TrainView view;
  view.camera = to_camera_view(test::look_at_origin(2, -1, 3, photograph.rgb.width, photograph.rgb.height));
  view.truth = tensor(photograph.rgb, {height, width, 3});
  view.n_valid = width * height;
  if (is_masked) view.valid = tensor(photograph.mask, {height, width});
  return view;
}

TEST(ViewReducer, PhotographAndMaskAreThoseOfADoubleReference) {
  for (const auto& [width, height, scale] : std::vector<std::array<int, 3>>{
           {64, 48, 2}, {65, 49, 2}, {62, 47, 3}, {33, 80, 4}, {64, 64, 8}, {17, 16, 8}, {7, 5, 5}}) {
    ViewReducer reducer(torch::kCPU);
    const Photograph photograph = make_photograph(width, height);
    for (const bool is_masked : {false, true}) {
      const TrainView view = make_view(photograph, is_masked);
      const TrainView reduced = reducer.reduce(view, is_masked ? &photograph.mask : nullptr, scale);
      ASSERT_EQ(reduced.truth.sizes(), (torch::IntArrayRef{height / scale, width / scale, 3}));
      ASSERT_EQ(reduced.camera.width, width / scale);
      ASSERT_EQ(reduced.camera.height, height / scale);
      EXPECT_EQ(reduced.valid.defined(), is_masked);
      std::int64_t n_valid = 0;
      for (int y = 0; y < height / scale; ++y) {
        for (int x = 0; x < width / scale; ++x) {
          double sum[3] = {0, 0, 0}, n = 0;
          for (int v = y * scale; v < (y + 1) * scale; ++v) {
            for (int u = x * scale; u < (x + 1) * scale; ++u) {
              const std::size_t p = static_cast<std::size_t>(v) * width + u;
              if (is_masked && photograph.mask.pixels[p] == 0) continue;
              ++n;
              for (std::size_t c = 0; c < 3; ++c) sum[c] += photograph.rgb.pixels[3 * p + c];
            }
          }
          const bool is_valid = n >= 0.5 * scale * scale;
          n_valid += is_valid;
          EXPECT_TRUE(!is_masked || reduced.valid[y][x].item<int>() == (is_valid ? 1 : 0)) << x << " " << y;
          for (int c = 0; c < 3; ++c) {
            EXPECT_EQ(reduced.truth[y][x][c].item<int>(), n == 0 ? 0 : std::floor(sum[c] / n + 0.5))
                << width << " x " << height << " / " << scale << " at " << x << " " << y;
          }
        }
      }
      EXPECT_EQ(reduced.n_valid, n_valid);
    }
  }
}

TEST(ViewReducer, APointProjectsToTheReducedPlace) {
  const Camera camera = test::look_at_origin(2, -1, 3, 1600, 1063);
  PinholeView view = to_camera_view(camera);
  view.cx += 12.25f;
  for (const int scale : {1, 2, 3, 4, 7, 8}) {
    const PinholeView reduced = reduced_camera(view, scale);
    EXPECT_EQ(reduced.width, 1600 / scale);
    EXPECT_EQ(reduced.height, 1063 / scale);
    for (const double x : {-0.4, 0.0, 0.35}) {
      for (const double y : {-0.3, 0.25}) {  // position at z = 1 in the camera's frame
        EXPECT_NEAR(reduced.fx * x + reduced.cx, (view.fx * x + view.cx) / scale, 1e-4);
        EXPECT_NEAR(reduced.fy * y + reduced.cy, (view.fy * y + view.cy) / scale, 1e-4);
      }
    }
    // The centre of the first reduced pixel is the middle of the scale x scale pixels that it covers.
    EXPECT_NEAR((0.5 - reduced.cx) / reduced.fx, (0.5 * scale - view.cx) / view.fx, 1e-6);
    EXPECT_TRUE(std::equal(std::begin(view.rotation.m), std::end(view.rotation.m), std::begin(reduced.rotation.m)));
  }
}

TEST(ViewReducer, ARenderedReducedViewIsTheReducedRender) {
  // The tiny scene is rendered from Gaussians that are several pixels large, so the mean over 2 x 2 pixels of one view
  // is close to the other view. With a camera that is off by half a pixel, the difference would be much larger.
  test::TinySceneOptions options;
  options.width = 200;
  options.height = 160;
  options.n_views = 1;
  const Scene scene = test::make_tiny_scene(options);
  SplatCloud cloud;
  const RandomKey key{11, RandomStream::kSplit, 0};
  for (int i = 0; i < 40; ++i) {
    const auto place = random_normal(key, i);
    for (int axis = 0; axis < 3; ++axis) {
      cloud.means.push_back(0.3f * place[axis]);
      cloud.log_scales.push_back(-2.0f);
      cloud.sh0.push_back(place[(axis + 1) % 3]);
    }
    for (const float q : {1.0f, 0.0f, 0.0f, 0.0f}) cloud.quats.push_back(q);
    cloud.logit_opacities.push_back(0.0f);
  }
  const GaussianTensors gaussians = to_tensors(cloud, 0, torch::kCPU);
  Rasterizer rasterizer(torch::kCPU);
  const PinholeView view = to_camera_view(scene.test[0].camera);
  const torch::Tensor full = rasterizer.forward(gaussians, view, {}).color.clone();
  const torch::Tensor small = rasterizer.forward(gaussians, reduced_camera(view, 2), {}).color.clone();
  const torch::Tensor mean = full.view({80, 2, 100, 2, 3}).mean({1, 3});
  const double error = (mean - small).abs().mean().item<double>();
  const double shifted = (mean.slice(1, 1) - small.slice(1, 0, 99)).abs().mean().item<double>();
  EXPECT_LT(error, 0.25 * shifted) << "one pixel off: " << shifted;
}

TEST(ViewReducer, KeepsItsBuffersAndDoesNotDependOnThreads) {
  ViewReducer reducer(torch::kCPU);
  const Photograph large = make_photograph(64, 48), small = make_photograph(40, 48);
  const TrainView first = reducer.reduce(make_view(large, true), &large.mask, 2);
  const torch::Tensor bytes = first.truth.clone();
  const void* const place = first.truth.data_ptr();
  EXPECT_EQ(reducer.reduce(make_view(small, true), &small.mask, 2).truth.data_ptr(), place);
  const int threads = thread_count();
  for (const int n : {1, 2, 3}) {
    set_thread_count(n);
    const TrainView again = reducer.reduce(make_view(large, true), &large.mask, 2);
    EXPECT_EQ(again.truth.data_ptr(), place);
    EXPECT_TRUE(test::same(again.truth, bytes));
  }
  set_thread_count(threads);
  const TrainView view = make_view(large, true);
  EXPECT_EQ(reducer.reduce(view, &large.mask, 1).truth.data_ptr(), view.truth.data_ptr()) << "scale 1 copies nothing";
}

TEST(CoarseTraining, LearnsAndEvaluatesAtFullSize) {
  // The same scene as in Trainer.IgnoresInvalidPixels.
  test::TinySceneOptions options = test::learnable_scene();
  options.width = 90;
  options.height = 66;
  options.masked = true;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = 800;
  config.densify_from_iter = 100;
  config.test_iterations = {1};
  config.kernel = "sub-tile";
  config.coarse_scale = 3;
  config.coarse_until = 2400;  // longer than the training, which reaches the full size after 400 iterations
  ASSERT_EQ(coarse_scale_at(config, 100), 3);
  ASSERT_EQ(coarse_scale_at(config, 300), 2);
  ASSERT_EQ(coarse_scale_at(config, 401), 1);
  const TrainResult result = Trainer(finalize(config, scene), scene, ModelFolder(temp.path()), {}).run();
  ASSERT_EQ(result.evaluations.size(), 2u);
  EXPECT_LT(result.evaluations.front().second.mean.psnr, 20);
  EXPECT_GT(result.evaluations.back().second.mean.psnr, 28)
      << "the invalid pixels are white, and so would the model be";
}

}  // namespace
}  // namespace b3dgs
