#include "scene/crop_region.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

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

TEST(Crop, IsReadFromAFile) {
  const test::TempDir folder;
  const std::string file = (folder / "crop.txt").string();
  const auto parse = [&](const std::string& content) {
    test::write_bytes(file, content);
    return parse_crop(file);
  };
  EXPECT_EQ(parse("# written by b3dgs view\n\n-1, 0, 2, 3e-1\n").radius, 0.3);
  EXPECT_EQ(parse("1 2 3 4 5 6").high, (std::array<double, 3>{4, 5, 6}));
  const auto refuses = [&](const std::string& content, const std::string& part) {
    return fails_with<InputError>({"--crop " + file, part}, [&] { parse(content); });
  };
  EXPECT_TRUE(refuses("", "found none"));
  EXPECT_TRUE(refuses("0,0,0,1\n0,0,0,2\n", ":2: expected one region"));
  EXPECT_TRUE(refuses("\n0,0,0\n", ":2: expected a box"));
  EXPECT_TRUE(refuses("{\"box\": []}", ":1: expected a coordinate"));
  EXPECT_TRUE(refuses("0,0,0,1,1,0", "no volume"));
  EXPECT_TRUE(fails_with<InputError>({folder.path().string()}, [&] { parse_crop(folder.path().string()); }));
  EXPECT_TRUE(fails_with<InputError>({"no such file"}, [] { parse_crop("missing.txt"); }));
}

TEST(Crop, TextHasTheSameNumbers) {
  for (const char* text : {"-1,2.5,3,1e+06,0.125,1e-07", "1.23456789,0,-3,0.5"}) {
    const std::string written = crop_text(parse_crop(text));
    EXPECT_EQ(crop_text(parse_crop(written)), written);
  }
  EXPECT_EQ(crop_text(parse_crop("1,2,-3,-1,0,3")), "-1,0,-3,1,2,3");
  EXPECT_EQ(crop_text(parse_crop("500000.25,4000000.5,3,2")), "500000.25,4000000.5,3,2");
}

TEST(Crop, ContainsTheSamePointsInAFrame) {
  const CoordinateFrame frame{{1000, -20, 3}, 4};
  for (const char* text : {"996,-24,3,1004,-20,7", "1000,-20,3,4"}) {
    const CropRegion region = parse_crop(text), local = in_frame(frame, region);
    for (const std::array<double, 3>& at :
         {std::array<double, 3>{0, -0.5, 0.5}, {0.9, 0, 0.1}, {1.1, 0, 0}, {0, 0, -1}}) {
      EXPECT_EQ(local.contains(at), region.contains(frame.to_world(at.data()))) << text;
    }
  }
}

}  // namespace
}  // namespace b3dgs
