// The learned background on the GPU, compared with the CPU and with itself.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/background/background.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

const torch::Device kGpu(torch::kCUDA, 0);

RenderedView on_gpu(const RenderedView& view) {
  return {view.color.to(kGpu), {}, view.alpha.to(kGpu)};
}

BackgroundState on_gpu(const BackgroundState& background) {
  return {background.coefficients.to(kGpu), background.m.to(kGpu), background.v.to(kGpu), background.steps};
}

TEST(BackgroundOnGpu, EqualsTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(7);
  const PinholeView view = to_pinhole_view(test::look_at_origin(1, -2, 2, 203, 155));  // eight parts, the last not full
  for (const int degree : {0, 4}) {
    SCOPED_TRACE(degree);
    const RenderedView rendered{torch::rand({view.height, view.width, 3}), {}, torch::rand({view.height, view.width})};
    const torch::Tensor weights = torch::randn({view.height, view.width, 3});
    BackgroundState background = make_background(degree, torch::kCPU);
    background.coefficients.copy_(torch::randn_like(background.coefficients));
    BackgroundState own = on_gpu(background);
    const RenderedView own_rendered = on_gpu(rendered);
    add_background(background.coefficients, view, rendered);
    add_background(own.coefficients, view, own_rendered);
    EXPECT_TRUE(test::within(own_rendered.color.cpu(), rendered.color, 2e-6));

    BackgroundGradient gradient, own_gradient;
    const torch::Tensor alpha = gradient.compute(background, view, rendered, weights);
    const torch::Tensor own_alpha = own_gradient.compute(own, view, own_rendered, weights.to(kGpu));
    EXPECT_TRUE(test::within(own_alpha.cpu(), alpha, 1e-5));
    const double norm = gradient.coefficients().norm().item<double>();
    EXPECT_TRUE(test::within(own_gradient.coefficients().cpu(), gradient.coefficients(), 1e-4 * norm));
    const torch::Tensor first = own_gradient.coefficients().cpu().clone();
    own_gradient.compute(own, view, own_rendered, weights.to(kGpu));
    EXPECT_TRUE(torch::equal(own_gradient.coefficients().cpu(), first)) << "the same sums twice";

    gradient.step(0.01, background);
    own_gradient.step(0.01, own);
    EXPECT_TRUE(test::within(own.coefficients.cpu(), background.coefficients, 1e-4));
    EXPECT_EQ(own.steps, 1);
  }
}

TrainConfig sky_config() {
  TrainConfig config = test::eventful_config();
  config.device = "cuda";
  config.deterministic = true;
  config.random_background = false;
  config.background = "sky";
  return config;
}

Scene sky_scene() {
  test::TinySceneOptions options;
  options.n_views = 16;
  torch::manual_seed(8);
  options.background = 2 * torch::randn({25, 3});
  return test::make_tiny_scene(options);
}

TEST(BackgroundOnGpu, ResumedEqualsUninterruptedIfDeterministic) {
  B3DGS_NEEDS_GPU();
  const Scene scene = sky_scene();
  const test::TempDir temp;
  const TrainConfig config = sky_config();
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_TRUE(train(config, scene, temp / "again").checkpoint == whole.checkpoint);
  test::expect_exact_resume(config, scene, whole, temp.path(), {3, 10});
}

TEST(BackgroundOnGpu, LearnsAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  const Scene scene = sky_scene();
  const test::TempDir temp;
  TrainConfig config = sky_config();
  config.iterations = 200;
  config.background_lr = 0.1;
  config.densify_from_iter = 1000;
  config.opacity_reset_interval = 1000;
  const double gpu = train(config, scene, temp / "gpu").result.evaluations.back().second.mean.psnr;
  config.device = "cpu";
  const double cpu = train(config, scene, temp / "cpu").result.evaluations.back().second.mean.psnr;
  EXPECT_GT(cpu, 20);
  EXPECT_NEAR(gpu, cpu, 0.2);
}

}  // namespace
}  // namespace b3dgs
