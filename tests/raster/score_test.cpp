// Tests scores and absolute gradients against the double-precision reference.
#include <gtest/gtest.h>

#include <map>

#include "core/check.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/raster/score_check.h"

namespace b3dgs::test {
namespace {

bool is_equal(const GaussianScores& a, const GaussianScores& b) {
  return torch::equal(a.error_sum, b.error_sum) && torch::equal(a.weight_sum, b.weight_sum) &&
         torch::equal(a.max_weight, b.max_weight) && torch::equal(a.n_views, b.n_views);
}

class ScoreTest : public testing::TestWithParam<TestSceneRow> {};

TEST_P(ScoreTest, AgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  for (const auto& [culling, culling_name] : kCullings) {
    SCOPED_TRACE(culling_name);
    RenderSettings settings = settings_of(scene);
    settings.culling = culling;
    const torch::NoGradGuard no_grad;
    const DenseView reference = dense_render(to_dense_leaves(scene.gaussians), scene.view, settings);
    CpuView view(scene, settings);
    expect_same_scores(view, scene, reference);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ScoreTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

GaussianScores scores_of(const TestScene& scene, const RenderSettings& settings, const torch::Tensor& error) {
  const GaussianScores scores = make_scores(scene.gaussians.size());
  CpuView(scene, settings).score(error, scores);
  return scores;
}

torch::Tensor error_of(const TestScene& scene) {
  return uneven_error(scene.view);
}

TEST(Score, IsTheSameForAnyKernelAndNumberOfThreads) {
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  const GaussianScores expected = scores_of(scene, settings, error_of(scene));
  EXPECT_GT(expected.error_sum.sum().item<double>(), 100);
  for (const int threads : {1, 3}) {
    const ScopedThreadCount scoped(threads);
    EXPECT_TRUE(is_equal(scores_of(scene, settings, error_of(scene)), expected)) << threads << " threads";
  }
  std::map<KernelFamily, torch::Tensor> n_views;  // depend on the tiles, which decide what is visible
  for (const KernelRow& kernel : kForwardKernels) {
    settings.kernel = kernel.kernel;
    GaussianScores scores = scores_of(scene, settings, error_of(scene));
    EXPECT_TRUE(scores.n_views.equal(n_views.try_emplace(family_of(kernel.kernel), scores.n_views).first->second));
    scores.n_views = expected.n_views;
    EXPECT_TRUE(is_equal(scores, expected)) << kernel.name;
  }
}

TEST(Score, AddsToWhatIsThere) {
  const TestScene scene = anisotropic_cloud();
  CpuView view(scene, settings_of(scene));
  const GaussianScores once = make_scores(scene.gaussians.size()), twice = make_scores(scene.gaussians.size());
  view.score(error_of(scene), once);
  view.score(error_of(scene), twice);
  view.score(error_of(scene), twice);
  EXPECT_TRUE(test::same(twice.error_sum, 2 * once.error_sum));
  EXPECT_TRUE(test::same(twice.weight_sum, 2 * once.weight_sum));
  EXPECT_TRUE(test::same(twice.max_weight, once.max_weight)) << "a maximum";
  EXPECT_TRUE(test::same(twice.n_views, 2 * once.n_views));
}

TEST(Score, LimitsErrors) {
  const TestScene scene = anisotropic_cloud();
  const RenderSettings settings = settings_of(scene);
  const auto with = [&](float error) {
    return scores_of(scene, settings, torch::full({scene.view.height, scene.view.width}, error));
  };
  const GaussianScores one = with(1);
  EXPECT_TRUE(is_equal(with(1e9f), one));
  EXPECT_TRUE(is_equal(with(-3), with(0)));
  EXPECT_TRUE(is_equal(with(NAN), with(0)));
  EXPECT_EQ(with(0).error_sum.abs().max().item<float>(), 0);
}

TEST(Score, LeavesRoomForAnotherBackwardPass) {
  const TestScene scene = anisotropic_cloud();
  const RenderedViewGrad grad = uneven_grad(scene.view);
  CpuView view(scene, settings_of(scene));
  const DenseGradients before = view.backward(grad);
  view.score(error_of(scene), make_scores(scene.gaussians.size()));
  EXPECT_TRUE(test::same(view.backward(grad).parameters.means, before.parameters.means));
}

TEST(Score, OfTheTorchLayerIsTheRasterizersAndChecksItsTensors) {
  const TestScene scene = odd_image_size();
  const std::int64_t n = scene.gaussians.size();
  Rasterizer rasterizer(torch::kCPU);
  const torch::Tensor error = error_of(scene);
  EXPECT_TRUE(fails_with<LogicError>({"before any forward"}, [&] { rasterizer.score(error, make_scores(n)); }));
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  const GaussianScores scores = make_scores(n);
  rasterizer.score(error, scores);
  EXPECT_TRUE(is_equal(scores, scores_of(scene, settings_of(scene), error)));
  EXPECT_TRUE(fails_with<LogicError>({"error is", "expected [29, 37]"},
                                     [&] { rasterizer.score(error.t().contiguous(), make_scores(n)); }));
  const GaussianScores without{torch::zeros({n}), torch::zeros({n}), torch::zeros({n}), torch::Tensor()};
  rasterizer.score(error, without);
  EXPECT_TRUE(test::same(without.error_sum, scores.error_sum)) << "the sum of weights is optional";
  EXPECT_TRUE(
      fails_with<LogicError>({"error_sum is [", "expected ["}, [&] { rasterizer.score(error, make_scores(n + 1)); }));
}

}  // namespace
}  // namespace b3dgs::test
