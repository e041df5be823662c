// Tests the torch layer: it gives the same results as the CPU rasterizer, and checks tensors before reading them.
#include "raster/torch/rasterizer.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {
namespace {

RenderedViewGrad grad_for(const TestScene& scene) {
  return uneven_grad(scene.view);
}

TEST(Rasterizer, GivesWhatTheRasterizerBelowGives) {
  Rasterizer rasterizer(torch::kCPU);
  for (const TestScene& scene : {anisotropic_cloud(), degree_below_maximum(), no_higher_degrees(), empty_scene()}) {
    const RenderedView view = rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
    CpuView expected(scene, settings_of(scene));
    EXPECT_TRUE(test::same(view.color, expected.color));
    EXPECT_TRUE(test::same(view.depth, expected.depth));
    EXPECT_TRUE(test::same(view.alpha, expected.alpha));

    GaussianTensors grads;
    const ViewStatistics statistics = rasterizer.backward(scene.gaussians, grad_for(scene), grads);
    const DenseGradients expected_grads = expected.backward(grad_for(scene));
    for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
      EXPECT_TRUE(test::same(*grads.all()[i], *expected_grads.parameters.all()[i])) << GaussianTensors::kNames[i];
    }
    EXPECT_TRUE(test::same(statistics.means2d_grad, expected_grads.means2d));
    EXPECT_TRUE(test::same(statistics.radii.to(torch::kInt64), expected.radii()));
    EXPECT_EQ(statistics.radii.scalar_type(), torch::kInt32);
  }
}

TEST(Rasterizer, KeepsItsImagesForViewsOfSeveralSizes) {
  const TestScene scene = anisotropic_cloud();
  Rasterizer rasterizer(torch::kCPU);
  const auto render = [&](std::int32_t width, std::int32_t height) {
    PinholeView view = scene.view;
    view.width = width;
    view.height = height;
    const RenderedView rendered = rasterizer.forward(scene.gaussians, view, settings_of(scene));
    EXPECT_EQ(rendered.color.sizes(), (std::vector<std::int64_t>{height, width, 3}));
    EXPECT_TRUE(
        test::same(rendered.color, Rasterizer(torch::kCPU).forward(scene.gaussians, view, settings_of(scene)).color));
    return std::array<const void*, 3>{rendered.color.data_ptr(), rendered.depth.data_ptr(), rendered.alpha.data_ptr()};
  };
  const auto places = render(60, 40);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(render(30, 50), places);
    EXPECT_EQ(render(60, 40), places);
  }
  rasterizer.release_memory();
  EXPECT_THROW(rasterizer.count_load(), LogicError);
  render(60, 40);
  EXPECT_EQ(rasterizer.view_size().n_splats, CpuView(scene, settings_of(scene)).rasterizer().n_splats());
}

TEST(Rasterizer, HasNoViewAfterAForwardThatFailed) {
  const TestScene scene = smooth_scene();
  RenderSettings settings = settings_of(scene);
  Rasterizer rasterizer(torch::kCPU);
  const ViewSplats splats = rasterizer.project(scene.gaussians, scene.view, settings);
  settings.camera_gradient = true;  // needs the Gaussians
  EXPECT_THROW(rasterizer.forward_splats(splats, scene.view, settings), LogicError);
  EXPECT_THROW(rasterizer.backward_splats({}), LogicError);
}

TEST(Rasterizer, WritesGradientsIntoTheTensorsItIsGivenIfTheyFit) {
  const TestScene scene = smooth_scene();
  Rasterizer rasterizer(torch::kCPU);
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  GaussianTensors grads;
  rasterizer.backward(scene.gaussians, grad_for(scene), grads);
  const torch::Tensor first = grads.means.clone();
  const float* const memory = grads.means.data_ptr<float>();
  grads.means.fill_(7);
  grads.quats = torch::zeros({3, 4});
  rasterizer.backward(scene.gaussians, grad_for(scene), grads);
  EXPECT_EQ(grads.means.data_ptr<float>(), memory);
  EXPECT_TRUE(test::same(grads.means, first)) << "overwritten, not added to";
  EXPECT_EQ(grads.quats.size(0), scene.gaussians.size());
}

TEST(Rasterizer, NeverWritesGradientsInTheWrongOrder) {
  const TestScene scene = smooth_scene();
  Rasterizer rasterizer(torch::kCPU);
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  GaussianTensors expected;
  rasterizer.backward(scene.gaussians, grad_for(scene), expected);

  GaussianTensors strided;
  strided.means = torch::zeros({3, scene.gaussians.size()}).t();  // the right shape, but column-major
  try {
    rasterizer.backward(scene.gaussians, grad_for(scene), strided);
    EXPECT_TRUE(test::same(strided.means, expected.means));
  } catch (const LogicError&) {
  }
}

TEST(Rasterizer, NamesTheTensorThatDoesNotFit) {
  const auto refuses = [](const std::string& message, auto&& change) {
    TestScene scene = smooth_scene();
    change(scene.gaussians);
    return fails_with<LogicError>(
        {message}, [&] { Rasterizer(torch::kCPU).forward(scene.gaussians, scene.view, settings_of(scene)); });
  };
  EXPECT_TRUE(refuses("quats is [6, 4]", [](auto& g) { g.quats = g.quats.slice(0, 1); }));
  EXPECT_TRUE(refuses("means is Double", [](auto& g) { g.means = g.means.to(torch::kFloat64); }));
  EXPECT_TRUE(refuses("shN", [](auto& g) { g.shN = g.shN.transpose(1, 2).contiguous().transpose(1, 2); }));
  EXPECT_TRUE(refuses("shN", [](auto& g) { g.shN = g.shN.slice(1, 0, 5).contiguous(); }));
  EXPECT_TRUE(refuses("logit_opacities is undefined", [](auto& g) { g.logit_opacities = torch::Tensor(); }));
}

TEST(Rasterizer, RefusesGradientsOfAnotherImageSize) {
  const TestScene scene = smooth_scene();
  Rasterizer rasterizer(torch::kCPU);
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  RenderedViewGrad grad = grad_for(scene);
  grad.depth = torch::zeros({scene.view.width, scene.view.height});
  GaussianTensors grads;
  EXPECT_THROW(rasterizer.backward(scene.gaussians, grad, grads), LogicError);
}

TEST(Rasterizer, ReblendIsTheForwardOfThatKernelAndLeavesTheRestToBackward) {
  const TestScene scene = saturated_pixels();
  RenderSettings settings = settings_of(scene);
  Rasterizer again(torch::kCPU), direct(torch::kCPU);
  for (const KernelRow& kernel : kForwardKernels) {
    SCOPED_TRACE(kernel.name);
    settings.kernel = family_of(kernel.kernel) == KernelFamily::kPaper ? ForwardKernel::kNaive : kStandardKernel;
    again.forward(scene.gaussians, scene.view, settings);
    settings.kernel = kernel.kernel;
    const RenderedView wanted = direct.forward(scene.gaussians, scene.view, settings);
    const RenderedView found = again.reblend(kernel.kernel);
    EXPECT_TRUE(test::same(found.color, wanted.color));
    EXPECT_TRUE(test::same(found.depth, wanted.depth));
    EXPECT_TRUE(test::same(found.alpha, wanted.alpha));
    GaussianTensors wanted_grads, found_grads;
    direct.backward(scene.gaussians, grad_for(scene), wanted_grads);
    again.backward(scene.gaussians, grad_for(scene), found_grads);
    for (std::size_t i = 0; i < 6; ++i) EXPECT_TRUE(test::same(*found_grads.all()[i], *wanted_grads.all()[i]));
  }
}

TEST(Rasterizer, ReblendNeedsAForward) {
  Rasterizer rasterizer(torch::kCPU);
  EXPECT_THROW(rasterizer.reblend(ForwardKernel::kNaive), LogicError);
  EXPECT_THROW(rasterizer.reblend_backward({}), LogicError);
  EXPECT_THROW(rasterizer.measure_occupancy(ForwardKernel::kNaive), LogicError);
  EXPECT_THROW(rasterizer.count_load(), LogicError);
}

TEST(Rasterizer, ReblendRefusesAKernelOfTheOtherFamily) {
  const TestScene scene = smooth_scene();
  RenderSettings settings = settings_of(scene);
  Rasterizer rasterizer(torch::kCPU);
  rasterizer.forward(scene.gaussians, scene.view, settings);
  EXPECT_TRUE(test::fails_with<LogicError>({"naive", "sub-tile", "other family"},
                                           [&] { rasterizer.reblend(ForwardKernel::kNaive); }));
  const BlendRunner run_blend = [](const auto& blend) { blend(ForwardKernel::kCombined); };
  settings.run_blend = &run_blend;
  EXPECT_TRUE(test::fails_with<LogicError>({"combined", "sub-tile", "other family"},
                                           [&] { rasterizer.forward(scene.gaussians, scene.view, settings); }));
}

TEST(Rasterizer, BlendsWithTheKernelsThatTheSettingsRunAndKeepsTheLast) {
  const TestScene scene = saturated_pixels();
  RenderSettings settings = settings_of(scene);
  Rasterizer rasterizer(torch::kCPU), direct(torch::kCPU);
  settings.kernel = ForwardKernel::kNaive;
  const RenderedView wanted = direct.forward(scene.gaussians, scene.view, settings);
  const BlendRunner run_blend = [](const auto& blend) {
    blend(ForwardKernel::kCombined);  // its bits differ from those of naive
    blend(ForwardKernel::kNaive);
  };
  settings.run_blend = &run_blend;
  EXPECT_TRUE(test::same(rasterizer.forward(scene.gaussians, scene.view, settings).color, wanted.color));
  settings.run_blend = nullptr;
  settings.kernel = ForwardKernel::kCombined;
  EXPECT_FALSE(test::same(direct.forward(scene.gaussians, scene.view, settings).color,
                          rasterizer.reblend(ForwardKernel::kNaive).color));
}

TEST(Rasterizer, BackwardNeedsAForward) {
  const TestScene scene = smooth_scene();
  Rasterizer rasterizer(torch::kCPU);
  GaussianTensors grads;
  EXPECT_THROW(rasterizer.backward(scene.gaussians, grad_for(scene), grads), LogicError);
}

}  // namespace
}  // namespace b3dgs::test
