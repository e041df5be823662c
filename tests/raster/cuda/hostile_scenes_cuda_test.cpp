// Tests the CUDA rasterizer on extreme and invalid scenes, with every kernel.
#include "support/raster/hostile_scenes.h"

#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

TEST(HostileScenesCuda, GiveFiniteResultsOrAnErrorWithEveryKernel) {
  B3DGS_NEEDS_GPU();
  HostileOutcome outcome;
  for (std::uint32_t seed = 0; seed < hostile_scene_count(); ++seed) {
    const TestScene scene = hostile_scene(seed);
    RenderSettings settings = hostile_settings(scene, seed);
    for (const KernelRow& kernel : kForwardKernels) {
      SCOPED_TRACE(testing::Message() << "scene " << seed << ", " << kernel.name);
      settings.kernel = kernel.kernel;
      expect_finite_or_refused<CudaView>(scene, settings, outcome);
      if (HasFailure()) return;  // one failing case is enough
    }
  }
  EXPECT_GT(outcome.rendered, 700);
  EXPECT_GT(outcome.refused, 350);
}

}  // namespace
}  // namespace b3dgs::test
