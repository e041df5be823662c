// Scores and absolute gradients on the GPU.
#include <gtest/gtest.h>

#include "core/check.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/score_check.h"

namespace b3dgs::test {
namespace {

constexpr TileShape kTiles[] = {{16, 16}, {16, 8}};

class ScoreCudaTest : public testing::TestWithParam<TestSceneRow> {
 protected:
  void SetUp() override { B3DGS_NEEDS_GPU(); }
};

TEST_P(ScoreCudaTest, AgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  for (const TileShape tile : kTiles) {
    SCOPED_TRACE(tile.height);
    RenderSettings settings = settings_of(scene);
    settings.tile = tile;
    const torch::NoGradGuard no_grad;
    const DenseView reference = dense_render(to_dense_leaves(scene.gaussians), scene.view, settings);
    CudaView view(scene, settings);
    expect_same_scores(view, scene, reference);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ScoreCudaTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(ScoreCuda, IsTheSameTwiceAndForAnyKernel) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  const torch::Tensor error =
      uneven_error(scene.view, torch::zeros({scene.view.height, scene.view.width}, torch::kBool));
  GaussianScores first;
  for (int run = 0; run < 2; ++run) {
    for (const ForwardKernelName& kernel : kForwardKernels) {
      settings.kernel = kernel.kernel;
      const GaussianScores scores = make_scores(scene.gaussians.size());
      CudaView(scene, settings).score(error, scores);
      if (!first.error_sum.defined()) first = scores;
      EXPECT_TRUE(torch::equal(scores.error_sum, first.error_sum)) << kernel.name;
      EXPECT_TRUE(torch::equal(scores.weight_sum, first.weight_sum)) << kernel.name;
      EXPECT_TRUE(torch::equal(scores.max_weight, first.max_weight)) << kernel.name;
    }
  }
}

TEST(ScoreCuda, AllocatesNothingAfterABackwardPass) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = anisotropic_cloud();
  const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  CudaView view(scene, settings_of(scene));
  view.backward(uneven_grad(scene.view, nothing));
  const std::int64_t before = view.rasterizer().memory_bytes();
  view.score(uneven_error(scene.view, nothing), make_scores(scene.gaussians.size()));
  EXPECT_EQ(view.rasterizer().memory_bytes(), before);
}

TEST(AbsoluteGradientCuda, OfEveryKernelIsThatOfTheCpuAndChangesNoOther) {
  B3DGS_NEEDS_GPU();
  for (const TestScene& scene : {smooth_scene(), anisotropic_cloud(), saturated_pixels(), large_cloud()}) {
    RenderSettings settings = settings_of(scene);
    settings.absolute_gradient = true;
    const RenderedViewGrad grad =
        uneven_grad(scene.view, torch::zeros({scene.view.height, scene.view.width}, torch::kBool));
    CpuView cpu(scene, settings);
    cpu.backward(grad);
    const torch::Tensor expected = cpu.absolute_gradients().to(torch::kFloat64);
    for (const TileShape tile : kTiles) {
      settings.tile = tile;
      for (const BackwardKernelName& kernel : kBackwardKernels) {
        for (const bool deterministic : {false, true}) {
          if (deterministic && kernel.kernel != BackwardKernel::kPerSplat) continue;
          SCOPED_TRACE(testing::Message() << kernel.name << ", " << tile.height << ", " << deterministic);
          settings.backward_kernel = kernel.kernel;
          settings.deterministic = deterministic;
          CudaView view(scene, settings);
          const torch::Tensor centres = view.backward(grad).means2d, found = view.absolute_gradients();
          // Rounding may change a decision at a threshold, so sums are compared as a whole, too.
          const torch::Tensor error = (found.to(torch::kFloat64) - expected).norm();
          EXPECT_LE(error.item<double>(), 1e-3 * expected.norm().item<double>());
          EXPECT_TRUE(within(found, expected, 1e-3 * expected + 1e-3 * expected.max()));
          EXPECT_TRUE(torch::all(found * (1 + 1e-4) + 1e-6 >= centres.abs()).item<bool>());
          if (!deterministic) continue;
          settings.absolute_gradient = false;
          CudaView plain(scene, settings);
          EXPECT_TRUE(torch::equal(plain.backward(grad).means2d, centres));
          settings.absolute_gradient = true;
        }
      }
    }
  }
}

}  // namespace
}  // namespace b3dgs::test
