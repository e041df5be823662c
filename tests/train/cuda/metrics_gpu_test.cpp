// Tests the conversion of images to 8 bits on the GPU.
#include <gtest/gtest.h>

#include "support/gpu_test.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

TEST(MetricsOnGpu, BytesAreThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  // Tests values around each rounding threshold, in steps of a fraction of an ulp of 255 x, and values out of range.
  const torch::Tensor steps = torch::arange(-8, 8, torch::kFloat32).mul(2e-8);
  const torch::Tensor halves = torch::arange(0, 256, torch::kFloat32).add(0.5).div(255);
  const torch::Tensor special = torch::tensor({NAN, INFINITY, -INFINITY, -1.0f, 2.0f, 0.0f, 1.0f, 0.5f}).repeat({2, 1});
  const torch::Tensor image = torch::cat({(halves.unsqueeze(1) + steps).view({-1, 16}), special.view({1, 16})});
  const torch::Tensor on_gpu = image.to(torch::kCUDA);
  EXPECT_EQ(to_image8(on_gpu).pixels, to_image8(image).pixels);
  EXPECT_EQ(to_image8(on_gpu.t()).pixels, to_image8(image.t()).pixels);
  const torch::Tensor color = image.view({-1, 8, 2}).slice(2, 0, 1).repeat({1, 1, 3});
  EXPECT_EQ(to_image8(color.to(torch::kCUDA)).pixels, to_image8(color).pixels);
}

TEST(MetricsOnGpu, CopiesInHostMemoryArePinned) {
  B3DGS_NEEDS_GPU();
  const torch::Tensor image = torch::rand({7, 5}, torch::kCUDA);
  const torch::Tensor host = host_copy(image);
  EXPECT_TRUE(host.is_pinned());
  EXPECT_TRUE(host.equal(image.cpu()));
}

}  // namespace
}  // namespace b3dgs
