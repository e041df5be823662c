// Tests scores and absolute gradients on the GPU.
#include <gtest/gtest.h>

#include "core/check.h"
#include "support/approx.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/score_check.h"

namespace b3dgs::test {
namespace {

class ScoreCudaTest : public GpuSceneTest {};

TEST_P(ScoreCudaTest, AgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  const torch::NoGradGuard no_grad;
  for (const ForwardKernel kernel : {ForwardKernel::kNaive, kStandardKernel}) {
    SCOPED_TRACE(kernel_name(kernel));
    settings.kernel = kernel;
    const DenseView reference = dense_render(to_dense_leaves(scene.gaussians), scene.view, settings);
    CudaView view(scene, settings);
    expect_same_scores(view, scene, reference);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ScoreCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

TEST(ScoreCuda, IsTheSameTwiceAndForAnyKernel) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  const torch::Tensor error =
      uneven_error(scene.view, torch::zeros({scene.view.height, scene.view.width}, torch::kBool));
  GaussianScores first;
  for (int run = 0; run < 2; ++run) {
    for (const KernelRow& kernel : kForwardKernels) {
      settings.kernel = kernel.kernel;
      const GaussianScores scores = make_scores(scene.gaussians.size());
      CudaView(scene, settings).score(error, scores);
      if (!first.error_sum.defined()) first = scores;
      EXPECT_TRUE(test::same(scores.error_sum, first.error_sum)) << kernel.name;
      EXPECT_TRUE(test::same(scores.weight_sum, first.weight_sum)) << kernel.name;
      EXPECT_TRUE(test::same(scores.max_weight, first.max_weight)) << kernel.name;
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

}  // namespace
}  // namespace b3dgs::test
