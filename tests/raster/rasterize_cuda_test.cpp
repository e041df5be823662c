// The CUDA rasterizer against the dense reference: every forward and backward schedule, culling and tile shape, scene
// by scene; and against the CPU rasterizer where the reference is too slow.
#include "raster/cuda/rasterize_cuda.h"

#include <gtest/gtest.h>

#include <limits>

#include "check.h"
#include "raster/cuda_harness.h"
#include "raster/judge.h"

namespace b3dgs::test {
namespace {

class RasterizeCudaTest : public testing::TestWithParam<TestSceneRow> {
 protected:
  void SetUp() override { B3DGS_NEEDS_GPU(); }
};

TEST_P(RasterizeCudaTest, EveryKernelAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  for (const Judged& binning : kBinnings) {
    RenderSettings settings = settings_of(scene);
    settings.culling = binning.culling;
    settings.tile = binning.tile;
    const Judge judge(scene, settings);
    for (const ForwardKernelName& forward : kForwardKernels) {
      for (const BackwardKernelName& backward : kBackwardKernels) {
        SCOPED_TRACE(testing::Message() << forward.name << ", " << backward.name << ", " << binning.name);
        settings.kernel = forward.kernel;
        settings.backward_kernel = backward.kernel;
        CudaView view(scene, settings);
        expect_same_image(view, judge.view);
        expect_same_radii(view.radii(), judge.view);
        expect_same_gradients(view.backward(judge.grad), judge, judge.gradients);
        if (HasFailure()) return;  // one case says it all
      }
    }
  }
}

TEST_P(RasterizeCudaTest, GradientOfEachOutputAloneAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  const Judge judge(scene, settings);
  for (const BackwardKernelName& backward : kBackwardKernels) {
    settings.backward_kernel = backward.kernel;
    CudaView view(scene, settings);
    for (const auto& [name, grad] : {std::pair("colour", RenderedViewGrad{judge.grad.color, {}, {}}),
                                     std::pair("depth", RenderedViewGrad{{}, judge.grad.depth, {}}),
                                     std::pair("alpha", RenderedViewGrad{{}, {}, judge.grad.alpha})}) {
      SCOPED_TRACE(testing::Message() << name << ", " << backward.name);
      const TermSizes terms(judge, grad);
      expect_same_gradients(view.backward(grad), judge, dense_gradients(judge.leaves, judge.view, grad), &terms);
    }
  }
}

TEST_P(RasterizeCudaTest, SumsInAFixedOrderAgreeAndRepeatBitForBit) {
  const TestScene scene = GetParam().build();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  const Judge judge(scene, settings);
  CudaView first(scene, settings), second(scene, settings);
  DenseGradients found = first.backward(judge.grad), again = second.backward(judge.grad);
  expect_same_gradients(found, judge, judge.gradients);
  for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
    EXPECT_TRUE(found.parameters.all()[i]->equal(*again.parameters.all()[i])) << GaussianTensors::kNames[i];
  }
  EXPECT_TRUE(found.means2d.equal(again.means2d));
}

INSTANTIATE_TEST_SUITE_P(Scenes, RasterizeCudaTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

/// 100 000 Gaussians behind one another in a tile, so faint that thousands of them are seen.
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
    const torch::Tensor nothing_doubtful = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
    for (const ForwardKernelName& forward : kForwardKernels) {
      SCOPED_TRACE(testing::Message() << name << ", " << forward.name);
      settings.kernel = forward.kernel;
      CudaView view(scene, settings);
      // Without the reference no pixel is known to be near a decision: all but one in a thousand agree closely, and
      // what a flip can change is bounded.
      const torch::Tensor difference = (view.color - expected.color).abs();
      const auto n_far = (difference > 2e-5).sum().item<std::int64_t>();
      EXPECT_LE(n_far, 3 + difference.numel() / 1000);
      EXPECT_LE(difference.max().item<double>(), 0.011 * std::max(1.0, largest(expected.color, 1)));
    }
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
