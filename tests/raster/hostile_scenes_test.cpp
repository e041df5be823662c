// Tests the CPU rasterizer on extreme and invalid scenes, with every kernel and instruction set.
#include "support/raster/hostile_scenes.h"

namespace b3dgs::test {
namespace {

TEST(HostileScenes, GiveFiniteResultsOrAnErrorWithEveryKernel) {
  const std::vector<std::int64_t> targets = hwy::SupportedAndGeneratedTargets();
  HostileOutcome outcome;
  for (std::uint32_t seed = 0; seed < hostile_scene_count(); ++seed) {
    const TestScene scene = hostile_scene(seed);
    RenderSettings settings = hostile_settings(scene, seed);
    const ScopedSimdTarget simd(targets[seed % targets.size()]);
    for (const KernelRow& kernel : kForwardKernels) {
      SCOPED_TRACE(testing::Message() << "scene " << seed << ", " << kernel.name);
      settings.kernel = kernel.kernel;
      expect_finite_or_refused<CpuView>(scene, settings, outcome);
      if (HasFailure()) return;  // one failing case is enough
    }
  }
  EXPECT_GT(outcome.rendered, 600);
  EXPECT_GT(outcome.refused, 300);
}

}  // namespace
}  // namespace b3dgs::test
