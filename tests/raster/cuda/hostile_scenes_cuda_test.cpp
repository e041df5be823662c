// The CUDA rasterizer on extreme and invalid scenes, with every forward and backward kernel.
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
    for (const ForwardKernelName& forward : kForwardKernels) {
      for (const BackwardKernelName& backward : kBackwardKernels) {
        SCOPED_TRACE(testing::Message() << "scene " << seed << ", " << forward.name << ", " << backward.name);
        settings.kernel = forward.kernel;
        settings.backward_kernel = backward.kernel;
        expect_finite_or_refused<CudaView>(scene, settings, outcome);
        if (HasFailure()) return;  // one failing case is enough
      }
    }
  }
  EXPECT_GT(outcome.rendered, 1200);
  EXPECT_GT(outcome.refused, 600);
}

}  // namespace
}  // namespace b3dgs::test
