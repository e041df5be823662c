#include "scene/crop_region.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using test::fails_with;

TEST(Crop, IsABoxBetweenAnyTwoCornersOrASphere) {
  const CropRegion box = parse_crop("1,2,-3,-1,0,3");
  for (const std::array<double, 3>& inside : {std::array<double, 3>{0, 1, 0}, {1, 2, 3}, {-1, 0, -3}}) {
    EXPECT_TRUE(box.contains(inside));
  }
  for (const std::array<double, 3>& outside : {std::array<double, 3>{1.1, 1, 0}, {0, -0.1, 0}, {0, 1, 4}}) {
    EXPECT_FALSE(box.contains(outside));
  }
  const CropRegion sphere = parse_crop("1,0,0,0.5");
  const std::array<double, 3> inside{1.3, 0.3, 0}, outside{1.4, 0.4, 0};
  EXPECT_TRUE(sphere.contains(inside));
  EXPECT_FALSE(sphere.contains(outside));
}

TEST(Crop, RefusesOtherTexts) {
  for (const char* text : {"", "1", "1,2,3", "1,2,3,4,5", "1,2,3,4,5,6,7", "1,2,3,0", "1,2,3,-1", "1,2,3,nan",
                           "0,0,0,inf,1,1", "a,b,c,d", "1;2;3;4", "0,0,0,0,1,1"}) {
    EXPECT_TRUE(fails_with<InputError>({"--crop"}, [&] { parse_crop(text); })) << text;
  }
}

}  // namespace
}  // namespace b3dgs
