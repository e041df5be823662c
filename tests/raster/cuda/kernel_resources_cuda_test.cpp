// Resources that the tables of CUDA kernels report, for both tile shapes, on the GPU of this machine.
#include <gtest/gtest.h>

#include "raster/cuda/blend_kernels.h"
#include "support/gpu_test.h"

namespace b3dgs::cuda {
namespace {

constexpr TileShape kTiles[] = {{16, 8}, {16, 16}};

void expect_plausible(const KernelResources& resources) {
  EXPECT_EQ(resources.threads % 32, 0);
  EXPECT_GT(resources.threads, 0);
  EXPECT_GT(resources.registers, 0);
  EXPECT_LE(resources.registers, 255);
  EXPECT_EQ(resources.resident_threads % resources.threads, 0) << "whole blocks";
  EXPECT_GT(resources.occupancy(), 0) << "not one block fits";
  EXPECT_LE(resources.occupancy(), 1);
}

TEST(KernelResourcesCuda, EveryForwardKernelFits) {
  B3DGS_NEEDS_GPU();
  for (const TileShape& tile : kTiles) {
    for (const ForwardKernelName& kernel : kForwardKernels) {
      SCOPED_TRACE(testing::Message() << kernel.name << ", tile height " << tile.height);
      expect_plausible(kForwardTable[static_cast<std::size_t>(kernel.kernel)].resources(tile));
    }
  }
}

TEST(KernelResourcesCuda, EveryBackwardKernelFits) {
  B3DGS_NEEDS_GPU();
  for (const TileShape& tile : kTiles) {
    for (const BackwardKernelName& kernel : kBackwardKernels) {
      SCOPED_TRACE(testing::Message() << kernel.name << ", tile height " << tile.height);
      expect_plausible(kBackwardTable[static_cast<std::size_t>(kernel.kernel)].resources(tile));
    }
  }
}

TEST(KernelResourcesCuda, StagedSplatsShowAsSharedMemory) {
  B3DGS_NEEDS_GPU();
  const ForwardRow& row = kForwardTable[static_cast<std::size_t>(ForwardKernel::kNaive)];
  EXPECT_GT(row.resources(kTiles[0]).shared_bytes, 0);
}

}  // namespace
}  // namespace b3dgs::cuda
