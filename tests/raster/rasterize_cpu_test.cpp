// Tests the CPU rasterizer against the dense reference, with every kernel, culling, tile shape, instruction set and
// test scene.
#include "raster/cpu/passes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "core/check.h"
#include "raster/math/tiling.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/raster/cpu_harness.h"
#include "support/raster/reference_check.h"

namespace b3dgs::test {
namespace {

TEST(RasterizeCpu, MoreTilesThan16BitsCountMakeNoDifference) {
  constexpr int kScale = 6;
  TestScene scene = anisotropic_cloud();
  for (float* length : {&scene.view.fx, &scene.view.fy, &scene.view.cx, &scene.view.cy}) *length *= kScale;
  scene.view.width *= kScale;
  scene.view.height *= kScale;
  RenderSettings settings = settings_of(scene);
  const CpuView expected(scene, settings);
  settings.tile = TileShape{1, 1};
  const CpuView view(scene, settings);
  ASSERT_GT(view.rasterizer().grid().n_tiles(), 1 << 16);
  EXPECT_TRUE(test::same(view.color, expected.color));
  EXPECT_TRUE(test::same(view.depth, expected.depth));
}

class RasterizeCpuTest : public testing::TestWithParam<TestSceneRow> {};

/// Kernels of a group have the same tiles and lanes, and agree bit for bit. Training chooses among them by timing, and
/// its result must not depend on the choice.
const std::vector<ForwardKernel> kSameLanes[]{
    {ForwardKernel::kNaive, ForwardKernel::kSharedMemory, ForwardKernel::kDynamic},
    {ForwardKernel::kGaussianWise, ForwardKernel::kCombined},
    {ForwardKernel::kSubTile, ForwardKernel::kSegmented}};

/// Returns a kernel with the same bits as this one, or the kernel itself.
ForwardKernel first_of_same_lanes(ForwardKernel kernel) {
  for (const std::vector<ForwardKernel>& group : kSameLanes) {
    if (std::find(group.begin(), group.end(), kernel) != group.end()) return group.front();
  }
  return kernel;
}

/// Returns all results of a view and its backward pass.
std::vector<torch::Tensor> all_results(CpuView& view, const DenseGradients& gradients) {
  std::vector<torch::Tensor> results{view.color,   view.depth,       view.alpha, view.last_gaussians(),
                                     view.radii(), gradients.means2d};
  for (const torch::Tensor* group : gradients.parameters.all()) results.push_back(*group);
  return results;
}

std::vector<torch::Tensor> all_results(const TestScene& scene, const RenderSettings& settings) {
  CpuView view(scene, settings);
  return all_results(view, view.backward(uneven_grad(scene.view)));
}

void expect_same_bytes(const std::vector<torch::Tensor>& a, const std::vector<torch::Tensor>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_EQ(a[i].nbytes(), b[i].nbytes()) << "result " << i;
    if (a[i].nbytes() == 0) continue;
    if (std::memcmp(a[i].data_ptr(), b[i].data_ptr(), a[i].nbytes()) == 0) continue;
    ADD_FAILURE() << "result " << i << ": " << same(a[i], b[i]).message();
  }
}

TEST(RasterizeCpu, SplatsMayMissTheLargestTiles) {
  const TestScene scene = anisotropic_cloud();
  RenderSettings settings = settings_of(scene);
  settings.tile = TileShape{cpu::kMaxTileSide, cpu::kMaxTileSide};
  settings.culling = Culling::kSquare;  // lists then contain splats that reach no pixel of the tile
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    SCOPED_TRACE(hwy::TargetName(target));
    const ScopedSimdTarget simd(target);
    settings.kernel = ForwardKernel::kNaive;
    const std::vector<torch::Tensor> expected = all_results(scene, settings);
    for (const ForwardKernel kernel : {ForwardKernel::kSharedMemory, ForwardKernel::kSubTile}) {
      settings.kernel = kernel;
      expect_same_bytes(all_results(scene, settings), expected);
    }
  }
}

TEST_P(RasterizeCpuTest, EveryKernelOnEveryInstructionSetAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  const std::vector<std::int64_t> targets = hwy::SupportedAndGeneratedTargets();
  for (const auto& [culling, culling_name] : kCullings) {
    for (const KernelFamily family : kFamilies) {
      RenderSettings settings = settings_of(scene);
      settings.culling = culling;
      settings.tile = tile_of(family);
      const Reference reference(scene, settings);
      ASSERT_TRUE(reference.view.hazards.empty())
          << "scene cannot check a float rasterizer: " << reference.view.hazards.front();
      settings.tile.reset();
      for (const std::int64_t target : targets) {
        const ScopedSimdTarget simd(target);
        std::map<ForwardKernel, std::vector<torch::Tensor>> results;
        for (const KernelRow& kernel : kernels_of(family)) {
          SCOPED_TRACE(testing::Message() << kernel.name << ", " << culling_name << ", " << hwy::TargetName(target));
          settings.kernel = kernel.kernel;
          CpuView view(scene, settings);
          const DenseGradients gradients = view.backward(reference.grad);
          const auto [first, is_new] =
              results.try_emplace(first_of_same_lanes(kernel.kernel), all_results(view, gradients));
          if (is_new) {
            expect_same_image(view, reference.view);
            expect_same_radii(view.radii(), reference.view);
            expect_same_gradients(gradients, reference, reference.gradients);
          } else {
            expect_same_bytes(all_results(view, gradients), first->second);
          }
          if (HasFailure()) return;  // one failing case is enough
        }
      }
    }
  }
}

TEST(RasterizeCpu, PanoramaDoesNotShowItsSeam) {
  // If the camera is turned by half a circle, the seam is elsewhere, but the image is otherwise the same.
  TestScene scene = panorama();
  const CpuView view(scene, settings_of(scene));
  ASSERT_GT(view.rasterizer().n_splats(), (view.radii() > 0).sum().item<std::int64_t>() + 20) << "second splats";
  Mat3f& r = scene.view.rotation;
  for (int k = 0; k < 3; ++k) r(0, k) = -r(0, k), r(2, k) = -r(2, k);
  scene.view.translation.x = -scene.view.translation.x;
  scene.view.translation.z = -scene.view.translation.z;
  const CpuView turned(scene, settings_of(scene));
  EXPECT_TRUE(within(turned.color, view.color.roll(48, 1), 1e-4));
}

TEST(RasterizeCpu, PartOfAPanoramaIsThatPartOfTheImage) {
  TestScene scene = panorama();
  const CpuView whole(scene, settings_of(scene));
  scene.view.width = 64;
  scene.view.cx -= 16;
  const CpuView part(scene, settings_of(scene));
  EXPECT_TRUE(within(part.color, whole.color.narrow(1, 16, 64), 1e-4));
}

TEST_P(RasterizeCpuTest, GradientOfEachOutputAloneAgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  const RenderSettings settings = settings_of(scene);
  const Reference reference(scene, settings);
  CpuView view(scene, settings);
  for (const auto& [name, grad] : {std::pair("colour", RenderedViewGrad{reference.grad.color, {}, {}}),
                                   std::pair("depth", RenderedViewGrad{{}, reference.grad.depth, {}}),
                                   std::pair("alpha", RenderedViewGrad{{}, {}, reference.grad.alpha})}) {
    SCOPED_TRACE(name);
    expect_same_gradients(view.backward(grad), reference, dense_gradients(reference.leaves, reference.view, grad));
  }
}

TEST_P(RasterizeCpuTest, AntialiasedViewsAgreeWithTheDenseReference) {
  expect_same_antialiased_views<CpuView>(GetParam().build());
}

TEST_P(RasterizeCpuTest, InverseDepthAgreesWithTheDenseReference) {
  expect_same_inverse_depth<CpuView>(GetParam().build());
}

TEST_P(RasterizeCpuTest, AGaussianIsSeenExactlyIfItIsInTheListOfATile) {
  const TestScene scene = GetParam().build();
  for (const auto& [culling, culling_name] : kCullings) {
    SCOPED_TRACE(culling_name);
    RenderSettings settings = settings_of(scene);
    settings.culling = culling;
    const CpuView view(scene, settings);
    const RasterizerBackend& rasterizer = view.rasterizer();
    const BinnedSplats bins = rasterizer.bins();
    torch::Tensor listed = torch::zeros({scene.gaussians.size()}, torch::kBool);
    for (std::int64_t i = 0; i < bins.n_pairs; ++i) {
      listed[rasterizer.splats()[bins.splat_ids[i]].gaussian] = true;
    }
    EXPECT_TRUE(test::same(view.radii() > 0, listed));
    if (splats_per_gaussian(scene.view.lens) > 1) continue;
    EXPECT_EQ(listed.sum().item<std::int64_t>(), rasterizer.n_splats());
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, RasterizeCpuTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(RasterizeCpu, ResultsDoNotDependOnTheNumberOfThreads) {
  for (const TestScene& scene : {large_cloud(), anisotropic_cloud(), ten_thousand_in_one_tile()}) {
    for (const KernelRow& kernel : kForwardKernels) {
      SCOPED_TRACE(kernel.name);
      RenderSettings settings = settings_of(scene);
      settings.kernel = kernel.kernel;
      std::vector<torch::Tensor> single;
      {
        const ScopedThreadCount threads(1);
        single = all_results(scene, settings);
      }
      for (int n : {2, 3}) {
        const ScopedThreadCount threads(n);
        expect_same_bytes(all_results(scene, settings), single);
      }
    }
  }
}

TEST(RasterizeCpu, KernelsWithTheSameLanesAgreeBitForBitWhereNoPixelOfALongListFinishes) {
  TestScene scene = ten_thousand_in_one_tile();
  scene.gaussians.logit_opacities.fill_(std::log(0.006 / 0.994));
  const CpuView view(scene, settings_of(scene));
  ASSERT_LT(view.alpha.max().item<float>(), 0.99f);
  ASSERT_GT(view.alpha.max().item<float>(), 0.5f);
  const ScopedThreadCount threads(3);
  for (const auto& [culling, culling_name] : kCullings) {
    RenderSettings settings = settings_of(scene);
    settings.culling = culling;
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
      const ScopedSimdTarget simd(target);
      for (const std::vector<ForwardKernel>& kernels : kSameLanes) {
        settings.kernel = kernels.front();
        const std::vector<torch::Tensor> first = all_results(scene, settings);
        for (const ForwardKernel kernel : kernels) {
          SCOPED_TRACE(testing::Message()
                       << kernel_name(kernel) << ", " << culling_name << ", " << hwy::TargetName(target));
          settings.kernel = kernel;
          expect_same_bytes(all_results(scene, settings), first);
          if (testing::Test::HasFailure()) return;
        }
      }
    }
  }
}

TEST(RasterizeCpu, TooManyPairsAreRefusedBeforeTheyAreListed) {
  // Two splats on 6 x 4 tiles, of which the second covers all tiles.
  const TileGrid grid = make_tile_grid(96, 64, {16, 16});
  Splat splats[2]{};
  Vec2f extents[2]{{4, 4}, {200, 200}};
  std::int32_t radii[8]{};
  for (int m = 0; m < 2; ++m) {
    splats[m] = {};
    splats[m].mean_x = 40;
    splats[m].mean_y = 24;
    splats[m].log2_opacity = -0.1f;
    splats[m].conic_xx = splats[m].conic_yy = m == 0 ? 0.5f : 1e-5f;
    splats[m].depth = 1;
    splats[m].gaussian = 3 + 4 * m;
    radii[3 + 4 * m] = m == 0 ? 4 : 200;
  }
  cpu::BinBuffers buffers, fresh;
  cpu::BinArgs args{splats, extents, radii, 2, grid, Culling::kSquare};
  EXPECT_EQ(args.n_pairs_max, (std::int64_t{1} << 31) - 2) << "as on a GPU";
  args.n_pairs_max = 24 + 1;
  EXPECT_EQ(cpu::bin(args, buffers).n_pairs, 24 + 1);
  args.n_pairs_max = 24;
  EXPECT_TRUE(
      fails_with<NumericError>({"the view needs 25 (tile, Gaussian) pairs", "Gaussian 7 alone touches 24 of 24"},
                               [&] { cpu::bin(args, fresh); }));
  EXPECT_EQ(fresh.splat_ids.data(), nullptr);
}

TEST(RasterizeCpu, RunsAreReproducible) {
  const TestScene scene = saturated_pixels();
  for (const KernelRow& kernel : kForwardKernels) {
    SCOPED_TRACE(kernel.name);
    RenderSettings settings = settings_of(scene);
    settings.kernel = kernel.kernel;
    expect_same_bytes(all_results(scene, settings), all_results(scene, settings));
  }
}

TEST(RasterizeCpu, NothingIsLeftOverFromTheViewBefore) {
  // Renders scenes of different sizes through one rasterizer and through new ones.
  const std::unique_ptr<RasterizerBackend> reused = cpu::make_rasterizer();
  for (const TestScene& scene : {saturated_pixels(), one_pixel_image(), empty_scene(), anisotropic_cloud(),
                                 behind_the_camera(), odd_image_size(), opaque_front_layer()}) {
    const std::int64_t h = scene.view.height, w = scene.view.width;
    const torch::Tensor color = torch::empty({h, w, 3}), depth = torch::empty({h, w}), alpha = torch::empty({h, w});
    reused->forward(arrays_of(scene), scene.view, settings_of(scene),
                    {color.data_ptr<float>(), depth.data_ptr<float>(), alpha.data_ptr<float>()});
    const CpuView fresh(scene, settings_of(scene));
    expect_same_bytes({color, depth, alpha}, {fresh.color, fresh.depth, fresh.alpha});
  }
}

TEST(RasterizeCpu, CullingByEllipseChangesNoImageThatAllTilesWouldGive) {
  // With one tile for the whole image, culling excludes nothing. With small tiles, every pixel depends on it.
  for (const TestScene& scene : {anisotropic_cloud(), needles(), far_outside_the_field_of_view()}) {
    RenderSettings settings = settings_of(scene);
    settings.tile = TileShape{32, 32};
    const CpuView large(scene, settings);
    for (const TileShape tile :
         {TileShape{1, 1}, TileShape{3, 5}, TileShape{32, 1}, TileShape{1, 32}, TileShape{17, 9}}) {
      SCOPED_TRACE(testing::Message() << tile.width << " x " << tile.height);
      settings.tile = tile;
      settings.kernel = ForwardKernel::kCombined;  // quads are cut off at the edges of tiles of odd sides
      EXPECT_TRUE(within(CpuView(scene, settings).color, large.color, 1e-5));
      settings.kernel = ForwardKernel::kSubTile;
      const CpuView small(scene, settings);
      EXPECT_TRUE(within(small.color, large.color, 1e-6));
      EXPECT_TRUE(within(small.alpha, large.alpha, 1e-6));
      EXPECT_TRUE(within(small.last_gaussians(), large.last_gaussians(), 0));
    }
  }
}

TEST(RasterizeCpu, EmptySceneShowsTheBackground) {
  const TestScene scene = empty_scene();
  const CpuView view(scene, settings_of(scene));
  EXPECT_TRUE(within(view.color.select(2, 0), torch::full_like(view.alpha, scene.background.x), 0));
  EXPECT_TRUE(within(view.color.select(2, 2), torch::full_like(view.alpha, scene.background.z), 0));
  EXPECT_TRUE(within(view.depth, torch::zeros_like(view.depth), 0));
  EXPECT_TRUE(within(view.alpha, torch::zeros_like(view.alpha), 0));
}

TEST(RasterizeCpu, AMissingGradientCountsAsZeros) {
  const TestScene scene = odd_image_size();
  CpuView view(scene, settings_of(scene));
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const DenseGradients missing = view.backward({grad.color, {}, {}});
  const DenseGradients zeros =
      view.backward({grad.color, torch::zeros_like(grad.depth), torch::zeros_like(grad.alpha)});
  expect_same_bytes({missing.parameters.means, missing.parameters.quats},
                    {zeros.parameters.means, zeros.parameters.quats});
  const DenseGradients nothing = view.backward({});
  EXPECT_TRUE(within(nothing.parameters.means, torch::zeros_like(nothing.parameters.means), 0));
}

TEST(RasterizeCpu, NumericErrorNamesTheGaussianOfAParameterThatIsNotFinite) {
  for (std::size_t group = 0; group < GaussianTensors::kNames.size(); ++group) {
    for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                            -std::numeric_limits<float>::infinity()}) {
      SCOPED_TRACE(testing::Message() << GaussianTensors::kNames[group] << " " << bad);
      const TestScene scene = smooth_scene();
      scene.gaussians.all()[group]->view({7, -1})[5][0] = bad;
      EXPECT_TRUE(fails_with<NumericError>({"Gaussian 5 "}, [&] { CpuView(scene, settings_of(scene)); }));
    }
  }
}

TEST(RasterizeCpu, NumericErrorNamesTheGaussianThatIsAbsurdlyLarge) {
  const TestScene scene = smooth_scene();
  scene.gaussians.log_scales[5] = 12.0f;
  EXPECT_NO_THROW(CpuView(scene, settings_of(scene))) << "a million pixels";
  scene.gaussians.log_scales[5] = 30.0f;
  EXPECT_TRUE(fails_with<NumericError>({"Gaussian 5 "}, [&] { CpuView(scene, settings_of(scene)); }));
}

TEST(RasterizeCpu, NumericErrorNamesTheFirstOfSeveral) {
  const ScopedThreadCount threads(2);
  const TestScene scene = large_cloud();
  for (int i : {25017, 21003, 6}) {
    scene.gaussians.means[i][1] = NAN;
    EXPECT_TRUE(
        fails_with<NumericError>({"Gaussian " + std::to_string(i) + " "}, [&] { CpuView(scene, settings_of(scene)); }));
  }
}

TEST(RasterizeCpu, RefusesWhatItCannotRender) {
  const TestScene scene = smooth_scene();
  const auto render = [&](auto&& change) {
    RenderSettings settings = settings_of(scene);
    change(settings);
    const CpuView view(scene, settings);
  };
  EXPECT_THROW(render([](RenderSettings& s) { s.tile = TileShape{0, 16}; }), LogicError);
  EXPECT_THROW(render([](RenderSettings& s) { s.tile = TileShape{64, 16}; }), LogicError);
  EXPECT_THROW(render([](RenderSettings& s) { s.sh_degree = 4; }), LogicError);
  EXPECT_THROW(render([](RenderSettings& s) { s.sh_degree = -1; }), LogicError);
}

TEST(RasterizeCpu, BackwardNeedsAForward) {
  const std::unique_ptr<RasterizerBackend> rasterizer = cpu::make_rasterizer();
  const TestScene scene = smooth_scene();
  EXPECT_THROW(rasterizer->backward(arrays_of(scene), {}, {}), LogicError);
}

}  // namespace
}  // namespace b3dgs::test
