// Tests the gradient with respect to the camera's pose: that of the dense reference against finite differences, and
// that of the CPU rasterizer against the dense reference.
#include "support/raster/camera_gradient_check.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "raster/torch/rasterizer.h"
#include "support/approx.h"
#include "support/finite_difference.h"
#include "support/raster/clamped_scene.h"

namespace b3dgs::test {
namespace {

std::vector<double> to_vector(const torch::Tensor& tensor) {
  return {tensor.data_ptr<double>(), tensor.data_ptr<double>() + tensor.numel()};
}

/// Compares all six components with finite differences, without and with anti-aliasing.
void expect_reference_gradients_of(const TestScene& scene) {
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
  const auto loss_of = [&](const DenseView& view) {
    return ((view.color * grad.color).sum() + (view.depth * grad.depth).sum() + (view.alpha * grad.alpha).sum())
        .item<double>();
  };
  for (const bool antialiasing : {false, true}) {
    SCOPED_TRACE(testing::Message() << "antialiasing " << antialiasing);
    RenderSettings settings = settings_of(scene);
    settings.antialiasing = antialiasing;
    const torch::Tensor motion = torch::zeros({kCameraGradients}, torch::kFloat64).requires_grad_(true);
    const DenseView view = dense_render(leaves, scene.view, settings, motion);
    ASSERT_TRUE(view.hazards.empty()) << view.hazards.front();
    ASSERT_FALSE(view.near_decision.any().item<bool>());
    const auto value = [&](const std::vector<double>& x) {
      const torch::NoGradGuard no_grad;
      return loss_of(dense_render(leaves, scene.view, settings, torch::tensor(x, torch::kFloat64)));
    };
    const torch::Tensor found = dense_motion_gradient(motion, view, grad).contiguous();
    EXPECT_GT(found.abs().min().item<double>(), 1e-3) << "a number without effect checks nothing";
    EXPECT_TRUE(
        gradients_agree(to_vector(found), numeric_gradient(value, std::vector<double>(kCameraGradients)), 1e-8));
  }
}

TEST(CameraGradient, OfTheReferenceAgreesWithFiniteDifferences) {
  expect_reference_gradients_of(smooth_scene());
}

TEST(CameraGradient, OfTheReferenceAgreesWithFiniteDifferencesWhereTheProjectionIsClamped) {
  expect_reference_gradients_of(clamped_scene());
}

TEST(CameraGradient, AMotionOfNothingChangesNothingInTheReference) {
  const TestScene scene = anisotropic_cloud();
  const torch::NoGradGuard no_grad;
  const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
  const DenseView still = dense_render(leaves, scene.view, settings_of(scene));
  const torch::Tensor none = torch::zeros({kCameraGradients}, torch::kFloat64);
  // The camera's centre follows from its rounded rotation and translation.
  EXPECT_TRUE(within(dense_render(leaves, scene.view, settings_of(scene), none).color, still.color, 1e-5));
}

class CameraGradientTest : public testing::TestWithParam<TestSceneRow> {};

TEST_P(CameraGradientTest, AgreesWithTheDenseReference) {
  expect_same_camera_gradients<CpuView>(GetParam().build());
}

INSTANTIATE_TEST_SUITE_P(Scenes, CameraGradientTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(CameraGradient, DoesNotDependOnTheNumberOfThreads) {
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  settings.camera_gradient = true;
  const auto gradient_with = [&](int threads) {
    const ScopedThreadCount count(threads);
    CpuView view(scene, settings);
    view.backward(uneven_grad(scene.view));
    EXPECT_GT(view.rasterizer().n_splats(), 4096) << "too few for several chunks";
    return view.camera_gradient();
  };
  const torch::Tensor expected = gradient_with(1);
  EXPECT_GT(expected.abs().min().item<double>(), 0);
  for (const int threads : {2, 3, 5}) EXPECT_TRUE(test::same(gradient_with(threads), expected)) << threads;
}

TEST(CameraGradient, IsComputedOnlyIfTheSettingsSaySo) {
  const TestScene scene = one_splat();
  RenderSettings settings = settings_of(scene);
  CpuView without(scene, settings);
  without.backward(uneven_grad(scene.view));
  EXPECT_THROW(without.camera_gradient(), LogicError);
  settings.camera_gradient = true;
  const CpuView before_backward(scene, settings);
  EXPECT_THROW(before_backward.camera_gradient(), LogicError);
}

TEST(CameraGradient, IsPartOfTheStatisticsOfAView) {
  const TestScene scene = anisotropic_cloud();
  RenderSettings settings = settings_of(scene);
  const RenderedViewGrad grad = uneven_grad(scene.view);
  Rasterizer rasterizer(torch::kCPU);
  GaussianTensors grads;
  settings.camera_gradient = true;
  rasterizer.forward(scene.gaussians, scene.view, settings);
  const ViewStatistics with = rasterizer.backward(scene.gaussians, grad, grads);
  CpuView expected(scene, settings);
  expected.backward(grad);
  EXPECT_TRUE(test::same(with.camera_grad, expected.camera_gradient()));
  const torch::Tensor means = grads.means.clone();
  settings.camera_gradient = false;
  rasterizer.forward(scene.gaussians, scene.view, settings);
  const ViewStatistics without = rasterizer.backward(scene.gaussians, grad, grads);
  EXPECT_FALSE(without.camera_grad.defined());
  EXPECT_TRUE(test::same(grads.means, means)) << "other gradients are the same";
}

}  // namespace
}  // namespace b3dgs::test
