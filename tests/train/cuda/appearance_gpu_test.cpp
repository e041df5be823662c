// Compares appearance models on the GPU with those on the CPU.
#include <gtest/gtest.h>

#include "core/files/folders.h"
#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/appearance.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/appearance/appearance_model.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

AppearanceState on_gpu(const AppearanceState& state) {
  AppearanceState copy = state;
  visit_appearance(copy, [](const char*, torch::Tensor& tensor) { tensor = tensor.to(torch::kCUDA); });
  return copy;
}

TEST(AppearanceOnGpu, ExposuresAndTheirGradientsAreThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(6);
  const torch::Device gpu(torch::kCUDA, 0);
  TrainConfig config;
  config.iterations = 10;
  AppearanceModel host(config, 5, torch::kCPU), device(config, 5, gpu);
  AppearanceState state = host.make_state();
  state.exposures += 0.2 * torch::randn_like(state.exposures);
  AppearanceState own = on_gpu(state);
  for (int t = 1; t <= 10; ++t) {
    const int view = t * 3 % 5, height = 1 + 37 * t;
    const torch::Tensor image = 1.3 * torch::rand({height, 131, 3}), grad = torch::randn({height, 131, 3});
    const torch::Tensor own_image = image.to(gpu), own_grad = grad.to(gpu), again = own_grad.clone();
    if (t > 3) {  // clipped in part, far enough from the limit that rounding does not matter
      const torch::Tensor photograph = (torch::rand({height, 131, 3}) < 0.5).to(torch::kUInt8) * 255;
      host.set_photograph({});
      const torch::Tensor unsure = (host.apply(state, view, image) - 1).abs() < 1e-4;
      host.set_photograph(photograph.masked_fill(unsure, 0));
      device.set_photograph(photograph.masked_fill(unsure, 0).to(gpu));
    }
    EXPECT_TRUE(test::within(device.apply(own, view, own_image).to(torch::kCPU), host.apply(state, view, image), 1e-5));
    host.backward(state, view, image, grad);
    device.backward(own, view, own_image, own_grad);
    EXPECT_TRUE(test::within(own_grad.to(torch::kCPU), grad, 1e-5));
    const torch::Tensor expected = host.grad(), found = device.grad().clone();
    EXPECT_TRUE(test::within(found.to(torch::kCPU), expected, 1e-4 * (1 + expected.abs())));
    device.backward(own, view, own_image, again);
    EXPECT_TRUE(test::same(device.grad(), found)) << "the order of sums is fixed";
    host.step(view, t, state);
    device.step(view, t, own);
    EXPECT_TRUE(test::within(own.exposures.to(torch::kCPU), state.exposures, 1e-4)) << "step " << t;
  }
}

TEST(AppearanceOnGpu, BilateralGridsAndTheirGradientsAreThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(7);
  const torch::Device gpu(torch::kCUDA, 0);
  TrainConfig config;
  config.bilateral_grid = true;
  config.iterations = 20;
  AppearanceModel host(config, 5, torch::kCPU), device(config, 5, gpu);
  AppearanceState state = host.make_state();
  state.grids += 0.1 * torch::randn_like(state.grids);
  AppearanceState own = on_gpu(state);
  for (int t = 1; t <= 20; ++t) {
    const int view = t % 6 == 0 ? 0 : t * 3 % 5, height = 1 + 17 * t;
    const torch::Tensor image = 1.2 * torch::rand({height, 131, 3}) - 0.1, grad = torch::randn({height, 131, 3});
    const torch::Tensor own_image = image.to(gpu), own_grad = grad.to(gpu), again = own_grad.clone();
    host.begin_step(view, t, state);
    device.begin_step(view, t, own);
    EXPECT_TRUE(test::within(own.grids[view].to(torch::kCPU), state.grids[view], 1e-4)) << "step " << t;
    // Copies the grid, so that rounding does not add up.
    own.grids[view].copy_(state.grids[view]);
    EXPECT_TRUE(test::within(device.apply(own, view, own_image).to(torch::kCPU), host.apply(state, view, image), 1e-5));
    host.backward(state, view, image, grad);
    device.backward(own, view, own_image, own_grad);
    EXPECT_TRUE(test::within(own_grad.to(torch::kCPU), grad, 1e-4));
    const torch::Tensor expected = host.grad(), found = device.grad().clone();
    EXPECT_TRUE(test::within(found.to(torch::kCPU), expected, 1e-4 * (1 + expected.abs())));
    device.backward(own, view, own_image, again);
    EXPECT_TRUE(test::same(device.grad(), found)) << "the order of sums is fixed";
    host.step(view, t, state);
    device.step(view, t, own);
  }
}

}  // namespace
}  // namespace b3dgs
