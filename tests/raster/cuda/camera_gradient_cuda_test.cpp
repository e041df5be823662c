// Tests the gradient with respect to the camera's pose on the GPU against the dense reference and the CPU.
#include <gtest/gtest.h>

#include "core/check.h"
#include "support/approx.h"
#include "support/raster/camera_gradient_check.h"
#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

class CameraGradientCudaTest : public GpuSceneTest {};

TEST_P(CameraGradientCudaTest, AgreesWithTheDenseReference) {
  expect_same_camera_gradients<CudaView>(GetParam().build());
}

INSTANTIATE_TEST_SUITE_P(Scenes, CameraGradientCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

TEST(CameraGradientCuda, AgreesWithTheCpuOnManySplats) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  // All have one sign, so that the sum is large compared to the changes from pixels near a decision.
  const RenderedViewGrad grad{
      torch::ones({scene.view.height, scene.view.width, 3}), torch::ones({scene.view.height, scene.view.width}), {}};
  for (const bool antialiasing : {false, true}) {
    for (const bool deterministic : {false, true}) {
      SCOPED_TRACE(testing::Message() << "antialiasing " << antialiasing << ", deterministic " << deterministic);
      RenderSettings settings = settings_of(scene);
      settings.camera_gradient = true;
      settings.antialiasing = antialiasing;
      settings.deterministic = deterministic;
      CpuView expected(scene, settings);
      expected.backward(grad);
      CudaView view(scene, settings);
      ASSERT_GT(view.rasterizer().n_splats(), 4096);
      view.backward(grad);
      const torch::Tensor wanted = expected.camera_gradient(), found = view.camera_gradient();
      // The three components of a rotation have one size, and so do those of a translation.
      for (const int first : {0, 3}) {
        const torch::Tensor part = wanted.slice(0, first, first + 3);
        EXPECT_TRUE(within(found.slice(0, first, first + 3), part, 2e-3 * part.norm().item<double>())) << found << "\n"
                                                                                                       << wanted;
      }
      if (!deterministic) continue;
      CudaView again(scene, settings);
      again.backward(grad);
      EXPECT_TRUE(test::same(again.camera_gradient(), found)) << "sums in a fixed order repeat bit for bit";
    }
  }
}

TEST(CameraGradientCuda, IsComputedOnlyIfTheSettingsSaySo) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = anisotropic_cloud();
  const torch::Tensor none = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  CudaView without(scene, settings);
  const DenseGradients expected = without.backward(uneven_grad(scene.view, none));
  EXPECT_THROW(without.camera_gradient(), LogicError);
  settings.camera_gradient = true;
  CudaView with(scene, settings);
  EXPECT_THROW(with.camera_gradient(), LogicError);
  const DenseGradients found = with.backward(uneven_grad(scene.view, none));
  for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
    EXPECT_TRUE(test::same(*found.parameters.all()[i], *expected.parameters.all()[i])) << GaussianTensors::kNames[i];
  }
}

}  // namespace
}  // namespace b3dgs::test
