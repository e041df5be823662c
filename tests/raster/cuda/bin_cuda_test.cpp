// Tests the tiles of a splat on the GPU: as many pairs are written as were counted, and they are the same as on the
// host. Tiles are computed with the same bits everywhere (tiling.h), so these tests need no tolerance.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "raster/math/tiling.h"
#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

/// Outputs of the projection pass.
struct ProjectedRows {
  std::vector<Splat> splats;
  std::vector<Vec2f> extents;
  std::vector<std::int32_t> radii;
  cuda::ViewCounts counts{};
};

ProjectedRows project_on_gpu(const TestScene& scene, const RenderSettings& settings) {
  const DeviceGaussians gaussians(scene.gaussians);
  const std::int64_t n_rows = scene.gaussians.size() * splats_per_gaussian(scene.view.lens);
  const DeviceArray<Splat> splats(n_rows);
  const DeviceArray<Vec2f> extents(n_rows);
  const DeviceArray<std::int32_t> radii(n_rows);
  const DeviceArray<cuda::ViewCounts> counts(2);
  cuda::ProjectCudaArgs args;
  args.gaussians = gaussians.arrays();
  args.view = scene.view;
  args.sh_degree = settings.sh_degree;
  args.culling = settings.culling;
  args.grid = make_tile_grid(scene.view.width, scene.view.height, settings.tile_shape());
  args.out = {splats.data(), extents.data(), radii.data(), nullptr, counts.data()};
  DriverMemory memory;
  cuda::project(args, cuda::make_launch_context(nullptr, memory));
  return {download(splats.data(), n_rows), download(extents.data(), n_rows), download(radii.data(), n_rows),
          download(counts.data(), 1).front()};
}

/// Compares the pairs with the counts. Returns the length of the longest list.
std::int64_t expect_counted_pairs(const TestScene& scene, const RenderSettings& settings) {
  const ProjectedRows projected = project_on_gpu(scene, settings);
  const TileGrid grid = make_tile_grid(scene.view.width, scene.view.height, settings.tile_shape());
  std::int64_t n_pairs = 0;
  std::vector<std::size_t> by_depth;
  for (std::size_t i = 0; i < projected.radii.size(); ++i) {
    if (projected.radii[i] == 0) continue;
    by_depth.push_back(i);
    n_pairs += tiles_touched(grid, settings.culling, projected.splats[i], projected.extents[i], projected.radii[i]);
  }
  EXPECT_EQ(projected.counts.n_splats + projected.counts.n_second, static_cast<std::int64_t>(by_depth.size()));

  CudaView view(scene, settings);
  const BinnedSplats bins = view.rasterizer().bins();
  const std::vector<std::int64_t> offsets = download(bins.tile_offsets, grid.n_tiles() + 1);
  const std::vector<std::int32_t> ids = download(bins.splat_ids, bins.n_pairs);
  EXPECT_EQ(offsets.front(), 0);
  EXPECT_EQ(offsets.back(), n_pairs) << "fewer pairs were written than counted";
  EXPECT_EQ(bins.n_pairs, n_pairs);
  if (testing::Test::HasFailure()) return 0;
  std::stable_sort(by_depth.begin(), by_depth.end(),
                   [&](std::size_t a, std::size_t b) { return projected.splats[a].depth < projected.splats[b].depth; });
  std::vector<std::int64_t> next = offsets;
  std::int64_t n_wrong = 0;
  for (const std::size_t i : by_depth) {
    visit_tile_rows(grid, settings.culling, projected.splats[i], projected.extents[i], projected.radii[i],
                    [&](std::int32_t row, Span span) {
                      for (std::int32_t column = span.begin; column < span.end; ++column) {
                        const auto tile = static_cast<std::size_t>(row * grid.columns + column);
                        const std::int64_t place = next[tile]++;
                        n_wrong += place >= offsets[tile + 1] ||
                                   ids[static_cast<std::size_t>(place)] != static_cast<std::int32_t>(i);
                      }
                    });
  }
  EXPECT_EQ(n_wrong, 0) << "of " << n_pairs << " pairs are not where they are on the host";
  std::int64_t longest = 0;
  for (std::size_t tile = 0; tile + 1 < offsets.size(); ++tile) {
    longest = std::max(longest, offsets[tile + 1] - offsets[tile]);
  }
  return longest;
}

/// Runs the comparison with both cullings and the tiles of both families.
void expect_counted_pairs_of_all_kinds(const TestScene& scene) {
  for (const Culling culling : {Culling::kEllipse, Culling::kSquare}) {
    for (const ForwardKernel kernel : {ForwardKernel::kNaive, kStandardKernel}) {
      SCOPED_TRACE(testing::Message() << (culling == Culling::kEllipse ? "ellipse" : "square") << ", "
                                      << kernel_name(kernel));
      RenderSettings settings = settings_of(scene);
      settings.culling = culling;
      settings.kernel = kernel;
      settings.keep_for_backward = false;
      expect_counted_pairs(scene, settings);
    }
  }
}

class BinCudaTest : public GpuSceneTest {};

TEST_P(BinCudaTest, WritesThePairsThatTheProjectionCounts) {
  expect_counted_pairs_of_all_kinds(GetParam().build());
}

INSTANTIATE_TEST_SUITE_P(Scenes, BinCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

/// Makes a scene with sizes, shapes and opacities as after training: flat and long Gaussians of all sizes, a few that
/// cover much of the image, opacities near 0 and 1.
TestScene like_a_trained_scene(std::int64_t n, std::int32_t width, std::int32_t height) {
  torch::manual_seed(41);
  TestScene scene;
  const auto w = static_cast<float>(width), h = static_cast<float>(height);
  scene.view =
      PinholeView{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {}, {}, 0.9f * w, 0.9f * w, 0.49f * w, 0.52f * h, width, height};
  const torch::Tensor depth = torch::exp(torch::rand({n}) * 3.5 - 0.5);
  const torch::Tensor x = (torch::rand({n}) * 1.4 - 0.7) * depth, y = (torch::rand({n}) * 1.4 - 0.7) * depth;
  torch::Tensor log_scales = torch::randn({n, 3}) * 1.1 - 5.0 + torch::log(depth).unsqueeze(1);
  log_scales.select(1, 2) -= 2;
  log_scales.slice(0, 0, n / 1000) += 4;
  scene.gaussians = {torch::stack({x, y, depth}, 1).contiguous(),
                     log_scales.contiguous(),
                     torch::randn({n, 4}),
                     torch::randn({n}) * 4,
                     torch::randn({n, 1, 3}),
                     torch::zeros({n, 0, 3})};
  return scene;
}

TEST(BinCuda, WritesThePairsThatTheProjectionCountsOfManyGaussians) {
  B3DGS_NEEDS_GPU();
  expect_counted_pairs_of_all_kinds(like_a_trained_scene(50000, 1237, 822));
  expect_counted_pairs_of_all_kinds(like_a_trained_scene(10000, 4096, 4096));  // 2^16 and 2^17 tiles
  expect_counted_pairs_of_all_kinds(like_a_trained_scene(150000, 40, 24));     // lists of several runs (bin.cu)
}

TEST(BinCuda, WritesThePairsOfACrowdedTileAmongMoreTilesThanABlockCounts) {
  B3DGS_NEEDS_GPU();
  TestScene scene = like_a_trained_scene(20000, 800, 600);  // 1900 tiles; a block has counters for at most 1024
  scene.gaussians.means.slice(0, 0, 12000).slice(1, 0, 2).zero_();
  RenderSettings settings = settings_of(scene);
  settings.keep_for_backward = false;
  EXPECT_GT(expect_counted_pairs(scene, settings), 8192) << "the longest list is too short for blocks to count first";
}

TEST(BinCuda, SeesTheGaussiansThatTheCpuSees) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = like_a_trained_scene(50000, 1237, 822);
  RenderSettings settings = settings_of(scene);
  settings.keep_for_backward = false;
  const CpuView expected(scene, settings);
  const CudaView found(scene, settings);
  const torch::Tensor n_other = ((found.radii() > 0) != (expected.radii() > 0)).sum();
  EXPECT_LE(n_other.item<std::int64_t>(), 10) << "float rounding may change a few decisions";
  EXPECT_GT((expected.radii() > 0).sum().item<std::int64_t>(), 10000);
}

}  // namespace
}  // namespace b3dgs::test
