// Tests the forecast of a view's GPU memory, and the limit of its number of pairs.
#include "raster/view_memory.h"

#include <gtest/gtest.h>

#include "raster/checks.h"

namespace b3dgs {
namespace {

TEST(ViewMemory, IsWhatTheReadmeSays) {
  RenderSettings settings;
  settings.depth_gradient = false;
  CameraView view{};
  view.width = 160;
  view.height = 80;
  const auto view_memory = [&](const RenderSettings& of) { return b3dgs::view_memory(of, view); };
  const ViewMemory memory = view_memory(settings);
  EXPECT_EQ(memory.per_gaussian, 108);
  EXPECT_NEAR(memory.per_pair, 57.0, 0.1);
  EXPECT_EQ(memory.bytes(3, 1), 3 * 108 + memory.per_pair);
  settings.deterministic = true;
  EXPECT_EQ(view_memory(settings).per_gaussian, 116);
  EXPECT_NEAR(view_memory(settings).per_pair, 113.0, 0.1);
  settings.keep_for_backward = settings.deterministic = false;
  EXPECT_NEAR(view_memory(settings).per_pair, 22.0, 0.1);
  EXPECT_EQ(view_memory(settings).of_image, 160 * 80 * 8 + 50 * 92);
  settings.keep_for_backward = true;
  EXPECT_EQ(view_memory(settings).of_image, 160 * 80 * (8 + 16) + 50 * 92);
  view.width = 161;
  view.height = 81;
  EXPECT_EQ(view_memory(settings).of_image, 161 * 81 * 8 + 11 * 6 * (92 + 256 * 16));
  view.lens.kind = LensKind::kEquirectangular;
  EXPECT_EQ(view_memory(settings).per_gaussian, 2 * 108);
}

TEST(PairLimit, EndsBeforeSlotsDo) {
  EXPECT_EQ(kIndexMax, (std::int64_t{1} << 31) - 2);
  EXPECT_EQ(too_many_pairs(std::int64_t{1} << 33, {12, 4000}, 5000),
            "the view needs 8,589,934,592 (tile, Gaussian) pairs, more than 2,147,483,646; Gaussian 12 alone touches "
            "4,000 of 5,000 tiles; use smaller images (-r 2) or fewer Gaussians (--max_gaussians)");
}

}  // namespace
}  // namespace b3dgs
