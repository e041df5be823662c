// Compares the bilateral grid with LibTorch's grid_sample() in double precision, and tests trainings with it.
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/appearance.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/appearance/appearance_model.h"
#include "train/checkpoint/checkpoint.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

using test::like;
using test::to_doubles;
using test::train;
using test::Trained;

constexpr int kViews = 3;

TrainConfig grid_config() {
  TrainConfig config;
  config.bilateral_grid = true;
  return config;
}

AppearanceState random_state(const AppearanceModel& model) {
  AppearanceState state = model.make_state();
  state.grids += 0.2 * torch::randn_like(state.grids);
  return state;
}

/// Returns the grid [levels, height, width, 12] sliced by an image, in double.
torch::Tensor sliced(const torch::Tensor& grid, const torch::Tensor& image) {
  const std::int64_t height = image.size(0), width = image.size(1);
  const auto doubles = torch::TensorOptions(torch::kFloat64);
  const torch::Tensor luminance = (image * torch::tensor({0.299, 0.587, 0.114}, doubles)).sum(-1);
  const torch::Tensor x = (torch::arange(width, doubles) + 0.5) / width * 2 - 1,
                      y = (torch::arange(height, doubles) + 0.5) / height * 2 - 1;
  const torch::Tensor places = torch::stack(
      {x.view({1, width}).expand({height, width}), y.view({height, 1}).expand({height, width}), luminance * 2 - 1}, -1);
  const torch::Tensor transforms =
      torch::grid_sampler_3d(grid.permute({3, 0, 1, 2}).unsqueeze(0), places.view({1, 1, height, width, 3}),
                             /*bilinear*/ 0, /*border*/ 1, /*align_corners=*/true)
          .view({3, 4, height, width});
  const torch::Tensor ones = torch::ones({height, width, 1}, doubles);
  return torch::einsum("ikhw,hwk->hwi", {transforms, torch::cat({image, ones}, -1)});
}

torch::Tensor variation(const torch::Tensor& grid) {
  torch::Tensor sum = torch::zeros({}, torch::kFloat64);
  for (int axis = 0; axis < 3; ++axis) sum = sum + grid.diff(1, axis).square().mean();
  return sum;
}

TEST(BilateralGrid, StartsWithTransformsThatChangeNothing) {
  torch::manual_seed(1);
  AppearanceModel model(grid_config(), kViews, torch::kCPU);
  const AppearanceState state = model.make_state();
  const torch::Tensor image = torch::randn({19, 23, 3});
  EXPECT_TRUE(test::within(model.apply(state, 1, image), image, 1e-6));
  const torch::Tensor grad = torch::randn({19, 23, 3}), before = grad.clone();
  model.backward(state, 1, image, grad);
  EXPECT_TRUE(test::within(grad, before, 1e-6));
}

TEST(BilateralGrid, IsSlicedByPositionAndLuminance) {
  torch::manual_seed(2);
  AppearanceModel model(grid_config(), kViews, torch::kCPU);
  const AppearanceState state = random_state(model);
  for (const auto& [height, width] : std::vector<std::pair<int, int>>{{1, 1}, {7, 5}, {66, 90}, {15, 31}}) {
    const torch::Tensor image = 1.4 * torch::rand({height, width, 3}) - 0.2;  // with values below black and above white
    for (int view = 0; view < kViews; ++view) {
      const torch::Tensor grid = state.grids[view].to(torch::kFloat64);
      EXPECT_TRUE(test::within(model.apply(state, view, image), sliced(grid, image.to(torch::kFloat64)), 1e-5));
    }
  }
}

TEST(BilateralGrid, EveryPixelBelongsToOneCell) {
  for (const int size : {1, 2, 14, 15, 16, 31, 480, 1601}) {
    EXPECT_EQ(cell_begin(0, kCellColumns, size), 0);
    EXPECT_EQ(cell_begin(kCellColumns, kCellColumns, size), size);
    for (int cell = 0; cell < kCellColumns; ++cell) {
      for (int i = cell_begin(cell, kCellColumns, size); i < cell_begin(cell + 1, kCellColumns, size); ++i) {
        const GridPlace place = place_of_pixel(i, size, kCellColumns);
        EXPECT_EQ(place.index, cell) << i << " of " << size;
        EXPECT_NEAR(place.index + static_cast<double>(place.part), (i + 0.5) / size * 15, 1e-5);
      }
    }
  }
}

TEST(BilateralGrid, GradientsAreThoseOfTheReference) {
  torch::manual_seed(3);
  TrainConfig config = grid_config();
  config.bilateral_grid_tv = 3;
  AppearanceModel model(config, kViews, torch::kCPU);
  const AppearanceState state = random_state(model);
  torch::Tensor image = 1.2 * torch::rand({37, 41, 3}) - 0.1;
  const torch::Tensor weights = torch::randn({37, 41, 3});
  torch::Tensor grad = weights * model.apply(state, 2, image).cos();
  model.backward(state, 2, image, grad);
  torch::Tensor grid = state.grids[2].to(torch::kFloat64), pixels = image.to(torch::kFloat64);
  grid.requires_grad_(true);
  pixels.requires_grad_(true);
  const torch::Tensor loss = (weights.to(torch::kFloat64) * sliced(grid, pixels).sin()).sum() + 3 * variation(grid);
  loss.backward();
  const torch::Tensor scale = grid.grad().abs().max();
  EXPECT_TRUE(test::within(model.grad(), grid.grad(), 1e-5 * scale));
  EXPECT_GT((model.grad() != 0).sum().item<int>(), kGridSize / 2);
  EXPECT_TRUE(test::within(grad, pixels.grad(), 1e-4 * pixels.grad().abs().max()));
}

TEST(BilateralGrid, GradientsAreThoseOfFiniteDifferences) {
  torch::manual_seed(4);
  TrainConfig config = grid_config();
  config.bilateral_grid_tv = 3;
  AppearanceModel model(config, 1, torch::kCPU);
  const AppearanceState state = random_state(model);
  const torch::Tensor image = torch::rand({4, 5, 3}), weights = torch::randn({4, 5, 3});
  const torch::Tensor grid = state.grids[0];
  const auto loss = [&](const torch::Tensor& own_grid, const torch::Tensor& pixels) {
    return ((weights.to(torch::kFloat64) * sliced(own_grid, pixels).sin()).sum() + 3 * variation(own_grid))
        .item<double>();
  };
  const torch::Tensor grad = weights * model.apply(state, 0, image).cos();
  model.backward(state, 0, image, grad);
  const auto by_image = test::numeric_gradient(
      [&](const std::vector<double>& x) { return loss(grid.to(torch::kFloat64), like(x, image)); }, to_doubles(image),
      1e-5);
  EXPECT_TRUE(test::gradients_agree(to_doubles(grad), by_image, 1e-4));
  // Tests a column of vertices that several pixels use.
  const torch::Tensor column = grid.select(1, 9).select(1, 10);
  const auto by_column = test::numeric_gradient(
      [&](const std::vector<double>& x) {
        torch::Tensor changed = grid.to(torch::kFloat64).clone();
        changed.select(1, 9).select(1, 10).copy_(like(x, column));
        return loss(changed, image.to(torch::kFloat64));
      },
      to_doubles(column));
  EXPECT_TRUE(test::gradients_agree(to_doubles(model.grad().select(1, 9).select(1, 10)), by_column, 1e-4));
}

TEST(BilateralGrid, GradientDoesNotDependOnThreads) {
  torch::manual_seed(5);
  AppearanceModel model(grid_config(), 1, torch::kCPU);
  const AppearanceState state = random_state(model);
  const torch::Tensor image = torch::rand({90, 70, 3}), from = torch::randn({90, 70, 3});
  torch::Tensor first;
  const int threads = thread_count();
  for (const int n : {1, 2, 3}) {
    set_thread_count(n);
    model.backward(state, 0, image, from.clone());
    if (!first.defined()) first = model.grad().clone();
    EXPECT_TRUE(test::same(model.grad(), first)) << n << " threads";
  }
  set_thread_count(threads);
}

TEST(BilateralGrid, RateWarmsUpAndFalls) {
  const AppearanceModel model(grid_config(), 1, torch::kCPU);
  EXPECT_NEAR(model.rate(0), 0.002 * 0.01, 1e-12);
  EXPECT_NEAR(model.rate(500), 0.002 * 0.505 * std::pow(0.01, 500 / 30000.0), 1e-12);
  EXPECT_NEAR(model.rate(1000), 0.002 * std::pow(0.01, 1 / 30.0), 1e-12);
  EXPECT_NEAR(model.rate(15000), 0.002 * 0.1, 1e-12);
  EXPECT_NEAR(model.rate(30000), 0.002 * 0.01, 1e-12);
}

TEST(BilateralGrid, DeferredStepsAreThoseOfAdamOnAllGrids) {
  torch::manual_seed(6);
  TrainConfig config = grid_config();
  config.iterations = 400;
  AppearanceModel model(config, kViews, torch::kCPU);
  AppearanceState state = random_state(model);
  torch::Tensor expected = state.grids.to(torch::kFloat64), m = torch::zeros_like(expected),
                v = torch::zeros_like(expected);
  const torch::Tensor image = torch::rand({8, 9, 3});
  for (int t = 1; t <= config.iterations; ++t) {
    // View 0 is used often, view 1 now and then, and view 2 after more steps than are applied one by one.
    const int view = t == 5 || t == 390 ? 2 : t % 7 == 0 ? 1 : 0;
    model.begin_step(view, t, state);
    EXPECT_TRUE(test::within(state.grids[view], expected[view], 2e-5)) << "step " << t;
    model.backward(state, view, image, torch::randn({8, 9, 3}));
    torch::Tensor grad = torch::zeros_like(expected);
    grad[view] = model.grad().to(torch::kFloat64);
    model.step(view, t, state);
    m = 0.9 * m + 0.1 * grad;
    v = 0.999 * v + 0.001 * grad * grad;
    expected -= model.rate(t) * (m / (1 - std::pow(0.9, t))) / ((v / (1 - std::pow(0.999, t))).sqrt() + 1e-15);
  }
  for (int view = 0; view < kViews; ++view) model.begin_step(view, 401, state);
  EXPECT_TRUE(test::within(state.m[1], m[1], 1e-6));
  EXPECT_TRUE(test::within(state.v[2], v[2], 1e-6));
}

TEST(BilateralGridTraining, ReplacesExposuresOfACheckpoint) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.exposure = true;
  config.iterations = 6;
  const Trained first = train(config, scene, temp / "model");
  const ModelFolder folder(temp / "model");
  EXPECT_TRUE(std::filesystem::exists(folder.exposures()));
  config.iterations = 8;
  config.exposure = false;
  config.bilateral_grid = true;
  const Trained second = train(config, scene, temp / "model", first.result.checkpoint);
  const AppearanceState state = read_checkpoint(second.result.checkpoint, scene, torch::kCPU).state.appearance;
  EXPECT_EQ(state.steps, 2);
  EXPECT_FALSE(state.exposures.defined());
  EXPECT_FALSE(std::filesystem::exists(folder.exposures())) << "of the earlier session";
  EXPECT_TRUE(std::filesystem::exists(folder.exposures(6))) << "beside the PLY that they belong to";
  EXPECT_EQ(state.grids.sizes(), (torch::IntArrayRef{6, 8, 16, 16, 12}));
}

TEST(BilateralGridTraining, DamagedCheckpointsAreRefused) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.bilateral_grid = true;
  config.iterations = 3;
  const CheckpointFile whole = read_checkpoint_file(train(config, scene, temp / "model").result.checkpoint);
  const auto refused = [&](const std::string& part, auto&& damage) {
    CheckpointFile file = whole;
    damage(file);
    write_checkpoint_file(temp / "damaged.b3dgs", file);
    return test::fails_with<InputError>({"damaged.b3dgs", part},
                                        [&] { read_checkpoint(temp / "damaged.b3dgs", scene, torch::kCPU); });
  };
  EXPECT_TRUE(refused("appearance.v is", [&](CheckpointFile& file) {
    file.tensors.back().second = file.tensors.back().second.slice(1, 0, 4).contiguous();
  }));
  EXPECT_TRUE(refused("appearance_last_steps", [&](CheckpointFile& file) {
    file.header["appearance_last_steps"] = {0, 0};
  }));
  EXPECT_TRUE(
      refused("appearance_last_steps", [&](CheckpointFile& file) { file.header["appearance_last_steps"][0] = 4; }));
  EXPECT_TRUE(
      refused("appearance_last_steps", [&](CheckpointFile& file) { file.header["appearance_last_steps"] = "none"; }));
}

TEST(BilateralGridTraining, IsRefusedTogetherWithExposures) {
  TrainConfig config;
  config.exposure = config.bilateral_grid = true;
  EXPECT_TRUE(
      test::fails_with<InputError>({"--exposure and --bilateral_grid"}, [&] { check_options(config, torch::kCPU); }));
}

/// Returns the PSNR after `steps` steps on one photograph, whose render does not change.
double fitted_psnr(AppearanceModel& model, const torch::Tensor& render, const torch::Tensor& photograph, int steps) {
  AppearanceState state = model.make_state();
  ImageLoss loss(torch::kCPU);
  const std::int64_t n_pixels = render.size(0) * render.size(1);
  for (int t = 1; t <= steps; ++t) {
    model.begin_step(0, t, state);
    loss.compute(model.apply(state, 0, render), photograph, {}, n_pixels, {0.2});
    model.backward(state, 0, render, loss.grad().color);
    model.step(0, t, state);
  }
  const torch::Tensor difference = model.apply(state, 0, render) - photograph.to(torch::kFloat32) / 255;
  return -10 * std::log10(difference.square().mean().item<double>());
}

TEST(BilateralGrid, LearnsShadingThatAnExposureCannot) {
  // The photograph is darker towards the right and in the highlights, as with vignetting and tone mapping.
  const Scene scene = test::make_tiny_scene();
  const std::shared_ptr<const Image8> image = scene.train[0].image->read();
  const torch::Tensor bytes = torch::from_blob(const_cast<std::uint8_t*>(image->pixels.data()),
                                               {image->height, image->width, 3}, torch::kUInt8);
  const torch::Tensor render = bytes.to(torch::kFloat32) / 255;
  const torch::Tensor gain = 1 - 0.6 * torch::arange(image->width).view({1, -1, 1}) / image->width;
  const torch::Tensor photograph = (255 * gain * render.pow(0.8)).round().clamp(0, 255).to(torch::kUInt8);
  TrainConfig config = grid_config();
  config.iterations = 400;
  AppearanceModel grid(config, 1, torch::kCPU);
  config.bilateral_grid = false;
  AppearanceModel exposure(config, 2, torch::kCPU);  // two views, because the mean of one would stay the identity
  const double same = fitted_psnr(exposure, render, photograph, 0);
  const double by_exposure = fitted_psnr(exposure, render, photograph, config.iterations);
  const double by_grid = fitted_psnr(grid, render, photograph, config.iterations);
  EXPECT_GT(by_exposure, same + 1);
  EXPECT_GT(by_grid, by_exposure + 6);
}

}  // namespace
}  // namespace b3dgs
