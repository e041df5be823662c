// Tests depth, normals and confidence of surfaces on the GPU.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/geometry_check.h"

namespace b3dgs::test {
namespace {

class GeometryCudaTest : public GpuSceneTest {};

TEST_P(GeometryCudaTest, AgreesWithTheDenseReference) {
  TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  for (const ForwardKernel kernel : {ForwardKernel::kNaive, kStandardKernel}) {
    SCOPED_TRACE(kernel_name(kernel));
    settings.kernel = kernel;
    expect_same_surface<CudaView>(scene, settings);
  }
  add_filters(scene);
  settings.antialiasing = true;
  expect_same_surface<CudaView>(scene, settings);
}

INSTANTIATE_TEST_SUITE_P(Scenes, GeometryCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

TEST(GeometryCuda, IsTheSameTwiceAndForAnyKernel) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  for (const DepthKind kind : kDepthKinds) {
    settings.kernel = kStandardKernel;
    const SurfaceView first = CudaView(scene, settings).geometry(kind);
    for (int run = 0; run < 2; ++run) {
      for (const KernelRow& kernel : kForwardKernels) {
        settings.kernel = kernel.kernel;
        EXPECT_TRUE(is_same_surface(CudaView(scene, settings).geometry(kind), first)) << kernel.name;
      }
    }
  }
}

TEST(GeometryCuda, IsThatOfTheCpu) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  const RenderSettings settings = settings_of(scene);
  for (const DepthKind kind : {DepthKind::kSurface, DepthKind::kMean}) {
    const SurfaceView found = CudaView(scene, settings).geometry(kind);
    const SurfaceView expected = CpuView(scene, settings).geometry(kind);
    // Splats at the cutoff or the cap may be blended by only one of them.
    const torch::Tensor differs = (found.depth - expected.depth).abs() > 1e-4 * expected.depth + 1e-6;
    EXPECT_LE(differs.sum().item<std::int64_t>(), differs.numel() / 100);
  }
}

TEST(GeometryCuda, LeavesTheViewForABackwardPass) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = anisotropic_cloud();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  CudaView view(scene, settings);
  const DenseGradients before = view.backward(uneven_grad(scene.view, nothing));
  view.geometry(DepthKind::kSurface);
  EXPECT_TRUE(test::same(view.backward(uneven_grad(scene.view, nothing)).parameters.means, before.parameters.means));
}

}  // namespace
}  // namespace b3dgs::test
