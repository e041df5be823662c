// Tests which device is chosen, and which GPUs are rejected.
#include "train/device.h"

#include <gtest/gtest.h>

#include "raster/cuda/gpu_support.h"
#include "support/expect_error.h"
#include "support/train/tiny_scene.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

TEST(Device, AutoIsWhatTheMachineHas) {
  const torch::Device chosen = choose_device("auto");
  bool has_gpu = true;
  try {
    choose_device("cuda");
  } catch (const InputError&) {
    has_gpu = false;
  }
  EXPECT_EQ(chosen.is_cuda(), has_gpu);
  EXPECT_TRUE(choose_device("cpu").is_cpu());
}

TEST(Device, TheTrainerReportsAMissingGpu) {
  if (choose_device("auto").is_cuda()) GTEST_SKIP() << "this machine has a GPU";
  const Scene scene = test::make_tiny_scene();
  TrainConfig config;
  config.device = "cuda";
  EXPECT_TRUE(test::fails_with<InputError>({"--device cuda", "use --device cpu"},
                                           [&] { Trainer(finalize(config, scene), scene, ModelFolder(""), {}); }));
}

TEST(GpuSupport, AGpuWithoutCodeIsRefusedInALineThatNamesItsCapability) {
  const cuda::GpuSupport old{"NVIDIA GeForce RTX 2080 Ti", 75, {80, 90}, /*has_code=*/false};
  EXPECT_TRUE(test::fails_with<InputError>(
      {"NVIDIA GeForce RTX 2080 Ti has compute capability 7.5", "this build has code for 8.0, 9.0",
       "-DCMAKE_CUDA_ARCHITECTURES=75", "--device cpu"},
      [&] { cuda::require_support(old); }));
  EXPECT_NO_THROW(cuda::require_support({"NVIDIA H200", 90, {80, 90}, /*has_code=*/true}));
}

}  // namespace
}  // namespace b3dgs
