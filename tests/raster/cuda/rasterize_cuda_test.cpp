// Tests the CUDA rasterizer against the dense reference, with every forward and backward kernel, culling and test
// scene. Where the reference is too slow, tests it against the CPU rasterizer.
#include "raster/cuda/passes.h"

#include <gtest/gtest.h>

#include <limits>
#include <tuple>

#include "core/check.h"
#include "raster/math/tiling.h"
#include "raster/view_memory.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/reference_check.h"

namespace b3dgs::test {
namespace {

class RasterizeCudaTest : public GpuSceneTest {};

TEST_P(RasterizeCudaTest, EveryKernelAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  for (const auto& [culling, culling_name] : kCullings) {
    for (const KernelFamily family : kFamilies) {
      RenderSettings settings = settings_of(scene);
      settings.culling = culling;
      settings.tile = tile_of(family);
      const Reference reference(scene, settings);
      settings.tile.reset();
      for (const KernelRow& kernel : kernels_of(family)) {
        SCOPED_TRACE(testing::Message() << kernel.name << ", " << culling_name);
        settings.kernel = kernel.kernel;
        CudaView view(scene, settings);
        expect_same_image(view, reference.view);
        expect_same_radii(view.radii(), reference.view);
        expect_same_gradients(view.backward(reference.grad), reference, reference.gradients);
        if (HasFailure()) return;  // one failing case is enough
      }
    }
  }
}

TEST_P(RasterizeCudaTest, AntialiasedViewsAgreeWithTheDenseReference) {
  expect_same_antialiased_views<CudaView>(GetParam().build());
}

TEST_P(RasterizeCudaTest, InverseDepthAgreesWithTheDenseReference) {
  expect_same_inverse_depth<CudaView>(GetParam().build());
}

TEST_P(RasterizeCudaTest, SeesTheGaussiansThatTheCpuSees) {
  const TestScene scene = GetParam().build();
  for (const auto& [culling, culling_name] : kCullings) {
    SCOPED_TRACE(culling_name);
    RenderSettings settings = settings_of(scene);
    settings.culling = culling;
    const torch::NoGradGuard no_grad;
    const DenseView reference = dense_render(to_dense_leaves(scene.gaussians), scene.view, settings);
    expect_same_seen(CudaView(scene, settings).radii(), CpuView(scene, settings).radii(), reference);
  }
}

TEST_P(RasterizeCudaTest, GradientOfEachOutputAloneAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  const Reference reference(scene, settings);
  for (const ForwardKernel kernel : {ForwardKernel::kNaive, kStandardKernel}) {
    settings.kernel = kernel;
    CudaView view(scene, settings);
    for (const auto& [name, grad] : {std::pair("colour", RenderedViewGrad{reference.grad.color, {}, {}}),
                                     std::pair("depth", RenderedViewGrad{{}, reference.grad.depth, {}}),
                                     std::pair("alpha", RenderedViewGrad{{}, {}, reference.grad.alpha})}) {
      SCOPED_TRACE(testing::Message() << name << ", " << backward_kernel_of(family_of(kernel)));
      const TermSizes terms(reference, grad);
      expect_same_gradients(view.backward(grad), reference, dense_gradients(reference.leaves, reference.view, grad),
                            &terms);
    }
  }
}

TEST_P(RasterizeCudaTest, SumsInAFixedOrderAgreeAndRepeatBitForBit) {
  const TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  const Reference reference(scene, settings);
  CudaView first(scene, settings), second(scene, settings);
  DenseGradients found = first.backward(reference.grad), again = second.backward(reference.grad);
  expect_same_gradients(found, reference, reference.gradients);
  for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
    EXPECT_TRUE(found.parameters.all()[i]->equal(*again.parameters.all()[i])) << GaussianTensors::kNames[i];
  }
  EXPECT_TRUE(found.means2d.equal(again.means2d));
}

INSTANTIATE_TEST_SUITE_P(Scenes, RasterizeCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

/// Makes 100 000 Gaussians behind one another in a tile, so faint that thousands of them are visible.
TestScene hundred_thousand_in_one_tile() {
  TestScene scene = ten_thousand_in_one_tile();
  GaussianTensors& g = scene.gaussians;
  for (torch::Tensor* group : g.all()) {
    std::vector<std::int64_t> repeats(static_cast<std::size_t>(group->dim()), 1);
    repeats[0] = 10;
    *group = group->repeat(repeats).contiguous();
  }
  return scene;
}

TEST(RasterizeCuda, AgreesWithTheCpuOnLongListsAndManyGaussians) {
  B3DGS_NEEDS_GPU();
  for (const auto& [name, scene] :
       {std::pair("one tile", hundred_thousand_in_one_tile()), std::pair("large cloud", large_cloud())}) {
    RenderSettings settings = settings_of(scene);
    CpuView expected(scene, settings);
    for (const KernelRow& forward : kForwardKernels) {
      SCOPED_TRACE(testing::Message() << name << ", " << forward.name);
      settings.kernel = forward.kernel;
      CudaView view(scene, settings);
      // Without the reference, it is unknown which pixels are near a threshold. At most one in a thousand may differ,
      // and by no more than one decision can change.
      const torch::Tensor difference = (view.color - expected.color).abs();
      const auto n_far = (difference > 2e-5).sum().item<std::int64_t>();
      EXPECT_LE(n_far, 3 + difference.numel() / 1000);
      EXPECT_LE(difference.max().item<double>(), 0.011 * std::max(1.0, largest(expected.color, 1)));
    }
  }
}

/// Renders large_cloud() on 4480 x 4032 px, which are 70 560 tiles.
TestScene many_tiles() {
  constexpr int kScale = 56;
  TestScene scene = large_cloud();
  for (float* length : {&scene.view.fx, &scene.view.fy, &scene.view.cx, &scene.view.cy}) *length *= kScale;
  scene.view.width *= kScale;
  scene.view.height *= kScale;
  return scene;
}

TEST(RasterizeCuda, AgreesWithTheCpuOnMoreTilesThan16BitsCount) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = many_tiles();
  for (const bool deterministic : {false, true}) {
    RenderSettings settings = settings_of(scene);
    settings.deterministic = deterministic;
    CpuView expected(scene, settings);
    CudaView view(scene, settings);
    ASSERT_GT(view.rasterizer().grid().n_tiles(), 1 << 16);
    const torch::Tensor difference = (view.color - expected.color).abs();
    EXPECT_GT(expected.color.slice(0, 1024).abs().max().item<double>(), 0.1) << "the last tiles are empty";
    EXPECT_LE((difference > 2e-5).sum().item<std::int64_t>(), 3 + difference.numel() / 1000);
    EXPECT_LE(difference.max().item<double>(), 0.011);
    const RenderedViewGrad grad{torch::ones_like(expected.color), {}, {}};
    const torch::Tensor found = view.backward(grad).means2d, wanted = expected.backward(grad).means2d;
    EXPECT_TRUE(within(found, wanted, 1e-3 * largest(wanted, 1e-9)));
  }
}

TEST(RasterizeCuda, ThePapersFamilyTakesTheMemoryThatIsForecast) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  settings.depth_gradient = false;
  settings.kernel = ForwardKernel::kCombined;
  CudaView view(scene, settings);
  view.backward({torch::ones_like(view.color), {}, {}});
  const ViewMemory memory = view_memory(settings, scene.view);
  const double forecast = memory.of_image + memory.bytes(static_cast<double>(scene.gaussians.size()),
                                                         static_cast<double>(view.rasterizer().bins().n_pairs));
  const double taken = static_cast<double>(view.rasterizer().memory_bytes());
  EXPECT_GE(taken, forecast);
  EXPECT_LE(taken, 1.25 * forecast + (1 << 20));
}

TEST(RasterizeCuda, RefusesDeterministicGradientsWithThePapersFamily) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = smooth_scene();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  settings.kernel = ForwardKernel::kNaive;
  EXPECT_THROW(CudaView(scene, settings), LogicError);
}

TEST(RasterizeCuda, MeasuresTheOccupancyOfThePapersKernels) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  for (const KernelRow& row : kernels_of(KernelFamily::kPaper)) {
    SCOPED_TRACE(row.name);
    settings.kernel = row.kernel;
    CudaView view(scene, settings);
    const RenderedView before = view.image();
    const KernelOccupancy occupancy = view.rasterizer().measure_occupancy(row.kernel);
    EXPECT_GT(occupancy.registers, 0);
    EXPECT_GT(occupancy.shared_bytes, 0);
    EXPECT_GT(occupancy.blocks, 0);
    EXPECT_GT(occupancy.achieved, 0);
    EXPECT_LE(occupancy.achieved, occupancy.theoretical);
    EXPECT_LE(occupancy.theoretical, 1);
    EXPECT_GT(occupancy.active, 0);
    EXPECT_LE(occupancy.active, 1);
    EXPECT_TRUE(test::same(view.image().color, before.color)) << "measuring changed the image";
  }
  settings.kernel = kStandardKernel;
  CudaView view(scene, settings);
  EXPECT_THROW(view.rasterizer().measure_occupancy(kStandardKernel), LogicError);
}

TEST(RasterizeCuda, TakesTheMemoryThatIsForecast) {
  B3DGS_NEEDS_GPU();
  TestScene scene = large_cloud();
  for (const auto& [deterministic, lens] : {std::pair(false, LensKind::kPinhole), std::pair(true, LensKind::kPinhole),
                                            std::pair(true, LensKind::kEquirectangular)}) {
    scene.view.lens.kind = lens;
    RenderSettings settings = settings_of(scene);
    settings.deterministic = deterministic;
    settings.depth_gradient = false;
    settings.kernel = ForwardKernel::kSegmented;
    CudaView view(scene, settings);
    view.backward({torch::ones_like(view.color), {}, {}});
    const double n = static_cast<double>(scene.gaussians.size());
    const ViewMemory memory = view_memory(settings, scene.view);
    const double forecast = memory.of_image + memory.bytes(n, static_cast<double>(view.rasterizer().bins().n_pairs));
    const double taken = static_cast<double>(view.rasterizer().memory_bytes());
    EXPECT_GE(taken, forecast);
    // The forecast is for the longest segments. Views with few pairs have shorter ones: 28 bytes for each pixel of one.
    cuda::ViewCounts counts{};
    counts.n_pairs = view.rasterizer().bins().n_pairs;
    int n_multiprocessors = 0;
    ASSERT_EQ(cudaDeviceGetAttribute(&n_multiprocessors, cudaDevAttrMultiProcessorCount, 0), cudaSuccess);
    cuda::ListCut cut = cuda::list_cut(counts, n_multiprocessors);
    const std::int64_t n_segments = cut.segments_before(counts.n_pairs);
    cut.entries_log2 = cuda::ListCut::kMaxLog2;
    const double short_segments =
        static_cast<double>(n_segments - cut.segments_before(counts.n_pairs)) * kCudaTilePixels * 28;
    EXPECT_LE(taken, 1.25 * (forecast + short_segments) + (1 << 20));
    view.rasterizer().release_memory();
    EXPECT_EQ(view.rasterizer().memory_bytes(), 0);
  }
}

TEST(RasterizeCuda, ErrorNamesTheGaussianThatIsNotFiniteOrAbsurdlyLarge) {
  B3DGS_NEEDS_GPU();
  for (const float log_scale : {std::numeric_limits<float>::infinity(), 30.0f}) {
    TestScene scene = thirty_three_in_one_tile();
    scene.gaussians.log_scales[17][1] = log_scale;
    try {
      const CudaView view(scene, settings_of(scene));
      ADD_FAILURE() << "rendered without an error: " << log_scale;
    } catch (const NumericError& error) {
      EXPECT_NE(std::string(error.what()).find("Gaussian 17 "), std::string::npos) << error.what();
    }
  }
}

}  // namespace
}  // namespace b3dgs::test
