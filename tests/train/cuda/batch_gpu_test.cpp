// Compares steps along several views on the GPU (--batch) with those on the CPU, and deferred updates with immediate
// ones.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/optimizer/gaussian_optimizer.h"

namespace b3dgs {
namespace {

const torch::Device kGpu(torch::kCUDA, 0);
const AdamRates kRates{1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3};

GaussianTensors copy_to(const GaussianTensors& from, torch::Device device) {
  GaussianTensors copy;
  for (std::size_t i = 0; i < from.all().size(); ++i) *copy.all()[i] = from.all()[i]->clone().to(device);
  return copy;
}

/// Returns Gaussians of which 4 of 5 are in front of the cameras. Their number is not a multiple of the block size.
GaussianTensors some_gaussians() {
  constexpr std::int64_t kGaussians = 1003;
  GaussianTensors g{torch::randn({kGaussians, 3}),          torch::randn({kGaussians, 3}) * 0.3 - 2,
                    torch::randn({kGaussians, 4}),          torch::randn({kGaussians}),
                    torch::randn({kGaussians, 1, 3}) * 0.5, torch::randn({kGaussians, 15, 3}) * 0.1};
  g.means.slice(0, 0, c10::nullopt, 5).slice(1, 2, 3) -= 100;
  return g;
}

PinholeView view_from(double x, double z) {
  return to_camera_view(test::look_at_origin(x, 0, z, 90, 70));
}

RenderSettings settings_of(int sh_degree) {
  RenderSettings settings;
  settings.sh_degree = sh_degree;
  settings.deterministic = true;
  return settings;
}

void step_along(const std::vector<CameraView>& views, const RenderSettings& settings, const torch::Tensor& image_grad,
                Rasterizer& rasterizer, GaussianOptimizer& optimizer, GaussianTensors& gaussians, AdamState& state,
                const RegularizationWeights& weights = {}) {
  for (const CameraView& view : views) {
    rasterizer.forward(gaussians, view, optimizer.begin_view(gaussians, state, settings));
    optimizer.make_room_for_view(gaussians);
    optimizer.backward_and_keep(view, settings, {image_grad, {}, {}}, gaussians, weights);
  }
  optimizer.step_views(kRates, gaussians, state, nullptr);
}

TEST(BatchOnGpu, EqualsTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(5);
  const GaussianTensors start = some_gaussians();
  const torch::Tensor image_grad = torch::randn({70, 90, 3}) * 1e-3;
  const std::vector<CameraView> views{view_from(0, -6), view_from(2, -1.5), view_from(-3, -2)};
  for (const bool antialiasing : {false, true}) {
    for (const int sh_degree : {0, 1, 2, 3}) {
      SCOPED_TRACE(testing::Message() << "degree " << sh_degree << ", antialiasing " << antialiasing);
      const auto moments_on = [&](torch::Device device) {
        GaussianTensors gaussians = copy_to(start, device);
        AdamState state = make_adam_state(gaussians);
        Rasterizer rasterizer(device);
        GaussianOptimizer optimizer(rasterizer);
        RenderSettings settings = settings_of(sh_degree);
        settings.antialiasing = antialiasing;
        step_along(views, settings, image_grad.to(device), rasterizer, optimizer, gaussians, state, {0.01, 0.02});
        optimizer.flush(gaussians, state);
        EXPECT_EQ(state.steps, 3);
        return copy_to(state.m, torch::kCPU);
      };
      const GaussianTensors expected = moments_on(torch::kCPU), found = moments_on(kGpu);
      for (std::size_t i = 0; i < expected.all().size(); ++i) {
        const torch::Tensor& wanted = *expected.all()[i];
        EXPECT_TRUE(test::within(*found.all()[i], wanted, 2e-5 * wanted.abs().max().item<double>() + 1e-20))
            << GaussianTensors::kNames[i];
      }
    }
  }
}

TEST(BatchOnGpu, UpdatesGiveTheSameBitsWheneverTheyAreFlushed) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(6);
  constexpr int kSteps = 80;  // more than can be deferred, while the SH degree and the number of views change
  GaussianTensors often = copy_to(some_gaussians(), kGpu), late = copy_to(often, kGpu);
  AdamState often_state = make_adam_state(often), late_state = make_adam_state(often);
  Rasterizer rasterizer(kGpu);
  GaussianOptimizer often_optimizer(rasterizer), late_optimizer(rasterizer);
  const torch::Tensor image_grad = torch::randn({70, 90, 3}).to(kGpu) * 1e-3;
  for (int k = 0; k < kSteps; ++k) {
    std::vector<CameraView> views;
    for (int v = 0; v <= k % 3; ++v) views.push_back(view_from(0.7 * ((k * k + v) % 7 - 3), k % 5 == 0 ? -2.5 : -1.2));
    const RenderSettings settings = settings_of(std::min(k / 20, 3));
    step_along(views, settings, image_grad, rasterizer, late_optimizer, late, late_state);
    step_along(views, settings, image_grad, rasterizer, often_optimizer, often, often_state);
    often_optimizer.flush(often, often_state);
  }
  EXPECT_FALSE(torch::equal(late.shN, often.shN)) << "nothing was deferred";
  late_optimizer.flush(late, late_state);
  for (std::size_t i = 0; i < often.all().size(); ++i) {
    EXPECT_TRUE(test::same(*late.all()[i], *often.all()[i])) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::same(*late_state.m.all()[i], *often_state.m.all()[i])) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::same(*late_state.v.all()[i], *often_state.v.all()[i])) << GaussianTensors::kNames[i];
  }
}

}  // namespace
}  // namespace b3dgs
