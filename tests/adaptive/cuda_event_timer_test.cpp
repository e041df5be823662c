#include "adaptive/kernel_timer.h"

#include <gtest/gtest.h>

#include "support/gpu_test.h"

namespace b3dgs {
namespace {

TEST(CudaEventTimer, GivesOneTimeForEachPieceOfWorkInOrder) {
  B3DGS_NEEDS_GPU();
  constexpr std::int64_t kBytes = 256 << 20;
  const test::DeviceArray<unsigned char> memory(kBytes);
  CudaEventTimer timer(nullptr);
  const auto fill = [&](std::int64_t bytes) {
    return [&memory, bytes] {
      B3DGS_CUDA_CHECK(cudaMemsetAsync(memory.data(), 1, static_cast<std::size_t>(bytes), nullptr));
    };
  };
  timer.measure(fill(kBytes));
  timer.finish();  // warm-up: first uses are slow
  EXPECT_TRUE(timer.finish().empty());
  for (int round = 0; round < 3; ++round) {
    timer.measure(fill(kBytes));
    timer.measure(fill(16));
    timer.measure(fill(kBytes));
    const std::vector<double> ms = timer.finish();
    ASSERT_EQ(ms.size(), 3u);
    EXPECT_GT(ms[0], ms[1]) << "the first piece has 16 million times the work";
    EXPECT_GT(ms[2], ms[1]);
    EXPECT_GT(ms[1], 0);
  }
}

}  // namespace
}  // namespace b3dgs
