// Tests load counts against the tile lists, evaluated entry by entry in double.
#include <gtest/gtest.h>

#include "raster/math/blend.h"
#include "raster/math/tiling.h"
#include "raster/torch/rasterizer.h"
#include "support/approx.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {
namespace {

struct PixelCounts {
  std::int32_t processed = 0, contributing = 0;
};

/// Walks a tile's list by the blending rules (README of src/raster), without the code of src/raster. Sets `hazard`
/// where float rounding could lead to another decision.
PixelCounts count_by_the_rules(const std::vector<const Splat*>& list, double x, double y, bool* hazard) {
  PixelCounts counts;
  double transmittance = 1;
  for (const Splat* splat : list) {
    ++counts.processed;
    const double dx = x - splat->mean_x, dy = y - splat->mean_y;
    const double quadratic =
        splat->conic_xx * dx * dx + 2.0 * splat->conic_xy * dx * dy + double{splat->conic_yy} * dy * dy;
    const double alpha = std::min(0.99, std::exp2(splat->log2_opacity - quadratic));
    *hazard = *hazard || std::fabs(alpha * 255 - 1) < 1e-4;
    if (alpha < 1.0 / 255) continue;
    const double next = transmittance * (1 - alpha);
    *hazard = *hazard || std::fabs(next / 1e-4 - 1) < 1e-4;
    if (next < 1e-4) return counts;
    transmittance = next;
    ++counts.contributing;
  }
  return counts;
}

class CountLoadTest : public testing::TestWithParam<TestSceneRow> {};

TEST_P(CountLoadTest, CountsWhatTheListsSay) {
  const TestScene scene = GetParam().build();
  const std::int64_t n = arrays_of(scene).n_gaussians;
  const std::unique_ptr<RasterizerBackend> rasterizer = cpu::make_rasterizer();
  torch::Tensor color = torch::empty({scene.view.height, scene.view.width, 3}),
                depth = torch::empty({scene.view.height, scene.view.width}), alpha = torch::empty_like(depth);
  rasterizer->forward(arrays_of(scene), scene.view, settings_of(scene),
                      {color.data_ptr<float>(), depth.data_ptr<float>(), alpha.data_ptr<float>()});
  std::vector<std::int32_t> processed(static_cast<std::size_t>(depth.numel()), -1), contributing = processed;
  rasterizer->count_load(processed.data(), contributing.data());

  const TileGrid grid = rasterizer->grid();
  const BinnedSplats bins = rasterizer->bins();
  std::int64_t n_hazards = 0;
  for (std::int32_t tile = 0; tile < grid.n_tiles(); ++tile) {
    std::vector<const Splat*> list;
    for (std::int64_t i = bins.tile_offsets[tile]; i < bins.tile_offsets[tile + 1]; ++i) {
      list.push_back(rasterizer->splats() + bins.splat_ids[i]);
    }
    const Rect rect = tile_pixels(grid, tile);
    for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
      for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
        bool hazard = false;
        const PixelCounts wanted = count_by_the_rules(list, x + 0.5, y + 0.5, &hazard);
        const auto pixel =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(grid.image_width) + static_cast<std::size_t>(x);
        ASSERT_GT(processed[pixel], rasterizer->last_ids()[pixel]) << "the last splat blended must have been evaluated";
        ASSERT_LE(processed[pixel], static_cast<std::int32_t>(list.size()));
        n_hazards += hazard;
        if (hazard) continue;
        ASSERT_EQ(processed[pixel], wanted.processed) << x << ", " << y;
        ASSERT_EQ(contributing[pixel], wanted.contributing) << x << ", " << y;
      }
    }
  }
  EXPECT_LE(n_hazards, depth.numel() / 2) << "too few pixels were compared; " << n << " Gaussians";
}

INSTANTIATE_TEST_SUITE_P(Scenes, CountLoadTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(CountLoad, OfTheTorchLayerIsTheRasterizersAndItsTileListsAddUp) {
  const TestScene scene = odd_image_size();
  Rasterizer rasterizer(torch::kCPU);
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  const ViewLoad load = rasterizer.count_load();
  const CpuView view(scene, settings_of(scene));
  const RasterizerBackend& own = view.rasterizer();
  ASSERT_EQ(load.tile_lists.numel(), own.grid().n_tiles());
  EXPECT_EQ(load.tile_lists.sum().item<std::int64_t>(), own.bins().n_pairs);
  for (std::int64_t tile = 0; tile < own.grid().n_tiles(); ++tile) {
    EXPECT_EQ(load.tile_lists[tile].item<std::int64_t>(),
              own.bins().tile_offsets[tile + 1] - own.bins().tile_offsets[tile]);
  }
  torch::Tensor processed = torch::empty_like(load.processed), contributing = torch::empty_like(load.processed);
  own.count_load(processed.data_ptr<std::int32_t>(), contributing.data_ptr<std::int32_t>());
  EXPECT_TRUE(test::same(load.processed, processed));
  EXPECT_TRUE(test::same(load.contributing, contributing));
}

}  // namespace
}  // namespace b3dgs::test
