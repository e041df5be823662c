// Masks of photographs: how they are found, and how they affect pixels.
#include <gtest/gtest.h>

#include <algorithm>

#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "scene/images/image_folder.h"
#include "scene/scene_folder.h"
#include "scene/view_image.h"
#include "support/files.h"
#include "support/formats/write_transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::flat;
using test::kHeight;
using test::kWidth;

// Returns a white mask with black columns [from, to) at full width.
Image8 with_black_columns(int from, int to, int width = kWidth, int height = kHeight) {
  Image8 mask = flat(width, height, 1, 255);
  for (int y = 0; y < height; ++y) {
    for (int x = from; x < to; ++x) mask.pixels[static_cast<std::size_t>(y * width + x)] = 0;
  }
  return mask;
}

int value_at(const std::shared_ptr<const Image8>& mask, int x, int y) {
  return mask->pixels.at(static_cast<std::size_t>(y * mask->width + x));
}

class Masks : public test::SceneFolder {
 protected:
  void write_scene(const std::vector<std::string>& names, double k = 0) {
    model_.cameras[1] = {1, CameraModel::kSimpleRadial, kWidth, kHeight, {50, 20, 15, k}};
    for (const std::string& name : names) {
      const auto id = static_cast<std::uint32_t>(model_.images.size() + 1);
      model_.images.push_back({id, {1, 0, 0, 0}, {1.0 * id, 0, 0}, 1, name});
      write_image(folder_ / "images" / name, flat(kWidth, kHeight, 1, 100));
    }
    model_.points.push_back({1, {0, 0, 1}, {1, 2, 3}, 0});
    write_colmap_model(folder_ / "sparse/0", model_, ColmapFormat::kBinary);
  }

  ColmapModel model_;
};

TEST_F(Masks, AreFoundByTheNamesOfThePhotographs) {
  write_scene({"a.jpg", "b.jpg", "c.jpg", "left/d.png", "e.jpg"});
  EXPECT_TRUE(says(load(), "masks       none"));
  EXPECT_TRUE(load().warnings.empty());
  fs::create_directory(folder_ / "masks");
  ASSERT_EQ(load().warnings.size(), 1u) << "a folder whose masks do not match is no reason to train without";
  EXPECT_NE(load().warnings[0].find("no mask for any of the"), std::string::npos) << load().warnings[0];
  write_image(folder_ / "masks/a.png", with_black_columns(0, 5));
  write_image(folder_ / "masks/b.jpg.png", with_black_columns(0, 10));
  write_image(folder_ / "masks/c.mask.png", with_black_columns(0, 15));
  write_image(folder_ / "masks/left/d.png", with_black_columns(0, 20));
  const Scene scene = load();
  EXPECT_TRUE(says(scene, "masks       4 of 5 photographs, black is left out"));
  const std::vector<int> first_valid{5, 10, 15, 0, 20};  // in order of names
  for (std::size_t i = 0; i < 5; ++i) {
    const View& view = scene.train[i];
    if (first_valid[i] == 0) {
      EXPECT_EQ(view.valid, nullptr) << view.name;
      continue;
    }
    ASSERT_NE(view.valid, nullptr) << view.name;
    EXPECT_EQ(value_at(view.valid, first_valid[i] - 1, 3), 0) << view.name;
    EXPECT_EQ(value_at(view.valid, first_valid[i], 3), 255) << view.name;
    EXPECT_EQ(view.empty, nullptr);
    EXPECT_EQ(view.image->read()->pixels[0], 100) << "masked pixels keep their colours";
  }
  options_.masks = "none";
  EXPECT_EQ(load().train[0].valid, nullptr);
}

TEST_F(Masks, InvertAndSegment) {
  write_scene({"a.png"});
  write_image(folder_ / "masks/a.png", with_black_columns(0, 10));
  options_.empty_background = true;
  View view = load().train[0];
  EXPECT_EQ(value_at(view.valid, 9, 0), 0);
  EXPECT_EQ(value_at(view.empty, 9, 0), 255);
  EXPECT_EQ(value_at(view.empty, 10, 0), 0);
  options_.invert_masks = true;
  view = load().train[0];
  EXPECT_EQ(value_at(view.valid, 9, 0), 255);
  EXPECT_EQ(value_at(view.valid, 10, 0), 0);
  EXPECT_EQ(value_at(view.empty, 9, 0), 0);
  EXPECT_EQ(value_at(view.empty, 10, 0), 255);
}

TEST_F(Masks, AreReducedWithTheirPhotographs) {
  write_scene({"a.png"});
  write_image(folder_ / "masks/a.png", with_black_columns(0, 9));
  options_.resolution = 2;
  options_.empty_background = true;
  const View view = load().train[0];
  ASSERT_EQ(view.valid->width, kWidth / 2);
  // The pixel that covers columns 8 and 9 is neither valid nor empty.
  EXPECT_EQ(value_at(view.empty, 3, 0), 255);
  EXPECT_EQ(value_at(view.empty, 4, 0), 0);
  EXPECT_EQ(value_at(view.valid, 4, 0), 0);
  EXPECT_EQ(value_at(view.valid, 5, 0), 255);
}

TEST_F(Masks, AreUndistortedWithTheirPhotographs) {
  write_scene({"a.png"}, 0.3);
  const Scene plain = load();
  ASSERT_NE(plain.train[0].valid, nullptr);  // pixels outside of the photograph
  write_image(folder_ / "masks/a.png", with_black_columns(0, 20));
  options_.empty_background = true;
  const View view = load().train[0];
  // The photograph's centre does not move. Pixels that undistortion makes invalid are neither valid nor empty.
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool is_shown = value_at(plain.train[0].valid, x, y) == 255;
      EXPECT_EQ(value_at(view.valid, x, y), is_shown && x >= 20 ? 255 : 0) << x << " " << y;
      EXPECT_EQ(value_at(view.empty, x, y), is_shown && x < 20 ? 255 : 0) << x << " " << y;
    }
  }
}

TEST_F(Masks, OfOtherSizesAreResizedAndEqualOnesShareMemory) {
  write_scene({"a.png", "b.png", "c.png"});
  write_image(folder_ / "masks/a.png", with_black_columns(0, 20, 2 * kWidth, 2 * kHeight));
  write_image(folder_ / "masks/b.png", with_black_columns(0, 10));
  write_image(folder_ / "masks/c.png", flat(kWidth, kHeight, 1, 255));
  const Scene scene = load();
  EXPECT_EQ(value_at(scene.train[0].valid, 9, 0), 0);
  EXPECT_EQ(value_at(scene.train[0].valid, 10, 0), 255);
  EXPECT_EQ(scene.train[0].valid, scene.train[1].valid);
  EXPECT_EQ(scene.train[2].valid, nullptr);
  write_image(folder_ / "masks/b.png", flat(kWidth, kWidth, 1, 255));
  EXPECT_TRUE(refuses({"b.png", "aspect ratio", "40 x 30 px", "40 x 40 px"}));
  test::write_bytes(folder_ / "masks/b.png", "no image");
  EXPECT_TRUE(refuses({"masks/b.png", "cannot be decoded"}));
}

TEST_F(Masks, MayDifferByAPixelFromRounding) {
  const fs::path file = folder_ / "mask.png";
  for (const ImageSize size : {ImageSize{40, 30}, {80, 60}, {20, 15}}) {
    write_image(file, with_black_columns(0, size.width / 4, size.width, size.height));
    const Image8 mask = read_mask(file, {40, 31}, /*invert=*/false, 1);
    EXPECT_EQ(mask.size(), (ImageSize{40, 31}));
    for (const int y : {0, 30}) {
      EXPECT_EQ(*mask.at(9, y), 0) << size.width;
      EXPECT_EQ(*mask.at(10, y), 255) << size.width;
    }
    EXPECT_TRUE(fails_with<InputError>({"aspect ratio"}, [&] { read_mask(file, {40, 33}, false, 1); })) << size.width;
  }
}

TEST_F(Masks, AskedForAndNotFoundIsAnError) {
  write_scene({"a.png"});
  options_.masks = "segmentation";
  EXPECT_TRUE(refuses({"--masks segmentation", "folder not found"}));
  fs::create_directories(folder_ / "segmentation");
  EXPECT_TRUE(refuses({"segmentation", "no mask for any of the 1 photographs", "a.jpg.png"}));
  write_image(folder_ / "segmentation/a.png", with_black_columns(0, 10));
  EXPECT_EQ(value_at(load().train[0].valid, 9, 0), 0);
  options_.masks = (folder_ / "segmentation").string();
  EXPECT_EQ(value_at(load().train[0].valid, 9, 0), 0);
}

TEST_F(Masks, ThatLeaveNothingLeaveOutTheirPhotographs) {
  write_scene({"a.png", "b.png"});
  write_image(folder_ / "masks/a.png", flat(kWidth, kHeight, 1, 0));
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 1u);
  EXPECT_EQ(scene.train[0].name, "b.png");
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("no pixel of 1 of 2 photographs (first: a.png)"), std::string::npos);
  write_image(folder_ / "masks/b.png", flat(kWidth, kHeight, 1, 0));
  EXPECT_TRUE(refuses({"masks/a.png", "no pixel of any training photograph", "--invert_masks"}));
}

TEST_F(Masks, OfTransformsFilesAreUsed) {
  write_scene({"a.png", "b.png"});
  test::Json json = test::transforms_of(model_);
  json["frames"][0]["mask_path"] = "elsewhere/x.png";
  test::write_bytes(folder_ / "transforms.json", json.dump());
  fs::rename(folder_ / "sparse", folder_ / "not_searched");
  EXPECT_TRUE(refuses({"elsewhere/x.png"}));
  write_image(folder_ / "elsewhere/x.png", with_black_columns(0, 10));
  write_image(folder_ / "masks/b.png", with_black_columns(0, 20));
  const Scene scene = load();
  EXPECT_EQ(value_at(scene.train[0].valid, 10, 0), 255);
  EXPECT_EQ(value_at(scene.train[1].valid, 10, 0), 0);
}

TEST(ReadMask, TakesDarkGreyAsBlack) {
  const test::TempDir folder;
  Image8 mask = flat(2, 2, 1, 0);
  mask.pixels = {127, 128, 0, 255};
  write_image(folder / "a.png", mask);
  EXPECT_EQ(read_mask(folder / "a.png", {2, 2}, false).pixels, (std::vector<std::uint8_t>{0, 255, 0, 255}));
  EXPECT_EQ(read_mask(folder / "a.png", {2, 2}, true).pixels, (std::vector<std::uint8_t>{255, 0, 255, 0}));
}

}  // namespace
}  // namespace b3dgs
