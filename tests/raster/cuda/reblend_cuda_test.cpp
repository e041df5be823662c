// Tests blending a rendered view again with another kernel, and counting the load, on the GPU.
#include <gtest/gtest.h>

#include <vector>

#include "support/approx.h"
#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

TEST(ReblendCuda, IsTheForwardOfThatKernel) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = saturated_pixels();
  RenderSettings settings = settings_of(scene);
  for (const KernelRow& kernel : kForwardKernels) {
    SCOPED_TRACE(kernel.name);
    settings.kernel = family_of(kernel.kernel) == KernelFamily::kPaper ? ForwardKernel::kNaive : kStandardKernel;
    CudaView again(scene, settings);
    settings.kernel = kernel.kernel;
    const CudaView direct(scene, settings);
    again.rasterizer().reblend(kernel.kernel);
    const RenderedView found = again.image();
    EXPECT_TRUE(test::same(found.color, direct.color));
    EXPECT_TRUE(test::same(found.alpha, direct.alpha));
  }
}

/// Makes three tiles with lists of about 60,000, 900 and 60 small, faint splats. Pixels of the first tile end 35,000
/// splats deep or deeper, in various buckets. The parts behind a bucket are summed once for the first two tiles.
TestScene lists_of_very_different_length() {
  TestScene scene;
  scene.view = PinholeView{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {}, {}, 48, 48, 24, 8, 48, 16};
  std::vector<torch::Tensor> columns, all_depths;  // of the tiles
  for (const std::int64_t n : {60000, 900, 60}) {
    const torch::Tensor index = torch::arange(n, torch::kFloat64);
    columns.push_back(16 * (static_cast<double>(columns.size()) + torch::frac(0.7548776662 * index)));
    all_depths.push_back(2 + index / static_cast<double>(n));
  }
  const torch::Tensor depth = torch::cat(all_depths);
  const std::int64_t n = depth.numel();
  // Multiples of irrational numbers, which are evenly distributed.
  const torch::Tensor x = (torch::cat(columns) - 24) / 48;
  const torch::Tensor y = (torch::frac(0.5698402910 * torch::arange(n, torch::kFloat64)) - 0.5) / 3;
  scene.gaussians =
      make_spheres(torch::stack({x * depth, y * depth, depth}, 1), 0.0125 * depth, torch::full({n}, 0.02f));
  return scene;
}

TEST(ReblendCuda, BackwardKernelsSumTheSame) {
  B3DGS_NEEDS_GPU();
  for (const TestScene& scene : {anisotropic_cloud(), lists_of_very_different_length()}) {
    RenderSettings settings = settings_of(scene);
    const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
    const RenderedViewGrad uneven = uneven_grad(scene.view, nothing);
    const DeviceTensor grad(uneven.color), grad_depth(uneven.depth);
    for (const bool has_depth : {false, true}) {
      std::vector<torch::Tensor> sums;
      for (const ForwardKernel kernel : {ForwardKernel::kCombined, ForwardKernel::kSegmented}) {
        settings.kernel = kernel;
        CudaView view(scene, settings);
        view.rasterizer().reblend_backward({grad.data(), has_depth ? grad_depth.data() : nullptr, nullptr});
        const std::int64_t n_rows = view.rasterizer().n_rows();
        const std::vector<float> host = download(view.rasterizer().splat_grads(), n_rows * 12);
        sums.push_back(torch::tensor(host).view({n_rows, 12}).narrow(1, 0, has_depth ? 10 : 9));
      }
      const torch::Tensor norm = sums[0].square().sum(0).sqrt(), off = (sums[1] - sums[0]).square().sum(0).sqrt();
      EXPECT_GT(norm.min().item<double>(), 0);
      EXPECT_LE((off / norm).max().item<double>(), 1e-3);
    }
  }
}

TEST(CountLoadCuda, CountsAsTheCpuDoes) {
  B3DGS_NEEDS_GPU();
  for (const TestSceneRow& row : test_scenes()) {
    SCOPED_TRACE(row.name);
    const TestScene scene = row.build();
    const std::int64_t n_pixels = std::int64_t{scene.view.height} * scene.view.width;
    RenderSettings settings = settings_of(scene);
    for (const ForwardKernel kernel : {ForwardKernel::kNaive, kStandardKernel}) {
      SCOPED_TRACE(kernel_name(kernel));
      settings.kernel = kernel;
      const CpuView expected(scene, settings);
      std::vector<std::int32_t> processed(static_cast<std::size_t>(n_pixels)), contributing = processed;
      expected.rasterizer().count_load(processed.data(), contributing.data());

      CudaView view(scene, settings);
      const DeviceArray<std::int32_t> counts[2]{DeviceArray<std::int32_t>(n_pixels),
                                                DeviceArray<std::int32_t>(n_pixels)};
      view.rasterizer().count_load(counts[0].data(), counts[1].data());
      const std::vector<std::int32_t> found[2]{download(counts[0].data(), n_pixels),
                                               download(counts[1].data(), n_pixels)};
      // Rounding may change a decision at a threshold, which changes a count by one or finishes a pixel elsewhere.
      std::int64_t n_other = 0;
      for (std::size_t pixel = 0; pixel < processed.size(); ++pixel) {
        n_other += found[0][pixel] != processed[pixel] || found[1][pixel] != contributing[pixel];
      }
      EXPECT_LE(n_other, 2 + n_pixels / 100);
    }
  }
}

}  // namespace
}  // namespace b3dgs::test
