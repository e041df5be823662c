// Compares depth priors on the GPU with those on the CPU.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/depth_maps.h"
#include "support/train/training.h"
#include "train/depth/depth_priors.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

struct SceneWithDepth {
  SceneWithDepth() {
    test::TinySceneOptions options;
    options.masked = true;
    GaussianTensors truth;
    scene = test::make_tiny_scene(options, &truth);
    test::add_depth_maps(scene, truth, folder.path(), 1e-5, 0);
  }
  test::TempDir folder;
  Scene scene;
};

TEST(DepthPriorsOnGpu, GradientEqualsThatOfTheCpu) {
  B3DGS_NEEDS_GPU();
  const SceneWithDepth with;
  const torch::Device gpu(torch::kCUDA, 0);
  DepthPriors on_cpu(with.folder.path().string(), with.scene, torch::kCPU),
      on_gpu(with.folder.path().string(), with.scene, gpu);
  const View& view = with.scene.train[2];
  const torch::Tensor valid = torch::from_blob(const_cast<std::uint8_t*>(view.valid->pixels.data()),
                                               {view.camera.height, view.camera.width}, torch::kUInt8);
  const auto n_valid = (valid != 0).sum().item<std::int64_t>();
  for (const int reduction : {1, 2}) {
    const torch::Tensor rendered = torch::rand({view.camera.height / reduction, view.camera.width / reduction});
    const torch::Tensor used = reduction == 1 ? valid : torch::Tensor();
    const torch::Tensor expected = on_cpu.gradient(2, rendered, used, n_valid, valid, 0.5);
    const torch::Tensor found =
        on_gpu.gradient(2, rendered.to(gpu), used.defined() ? used.to(gpu) : used, n_valid, valid.to(gpu), 0.5);
    EXPECT_TRUE(test::within(found.cpu(), expected, 1e-12)) << reduction;
  }
}

}  // namespace
}  // namespace b3dgs
