#include "scene/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/check.h"
#include "core/files/folders.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "scene/photograph.h"
#include "scene/scene_folder.h"
#include "scene/view_image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::flat;
using test::kHeight;
using test::kWidth;
using test::TempDir;
using test::write_bytes;

std::string numbered_name(int i) {
  char name[32];
  std::snprintf(name, sizeof(name), "%02d.png", i);
  return name;
}

// Returns n images of a 40 x 30 pinhole camera on a line along x, in reverse order in the file. The grey value of each
// is its ID.
ColmapModel line_model(int n) {
  ColmapModel model;
  model.cameras[1] = {1, CameraModel::kPinhole, kWidth, kHeight, {50, 60, 21, 14}};
  for (int i = n - 1; i >= 0; --i) {
    model.images.push_back({static_cast<std::uint32_t>(100 + i), {1, 0, 0, 0}, {-1.0 * i, 0, 0}, 1, numbered_name(i)});
  }
  model.points.push_back({1, {1, 2, 3}, {10, 20, 30}, 0});
  return model;
}

class LoadScene : public testing::Test {
 protected:
  LoadScene() { options_.source_path = folder_.path().string(); }

  void write(const ColmapModel& model, const fs::path& model_folder = "sparse/0") {
    write_colmap_model(folder_ / model_folder, model, ColmapFormat::kBinary);
  }
  void write_images(const ColmapModel& model, const fs::path& image_folder = "images", int width = kWidth,
                    int height = kHeight) {
    for (const ColmapImage& image : model.images) {
      write_image(folder_ / image_folder / image.name, flat(width, height, 3, static_cast<int>(image.id)));
    }
  }
  void write_scene(int n) {
    write(line_model(n));
    write_images(line_model(n));
  }
  Scene load() {
    options_.frame = CoordinateFrame{};  // coordinates are compared with those of the files
    return load_scene(options_);
  }
  testing::AssertionResult refuses(std::initializer_list<std::string> parts) {
    return fails_with<InputError>(parts, [this] { load(); });
  }
  static testing::AssertionResult says(const Scene& scene, const std::string& part) {
    std::string all;
    for (const std::string& line : scene.summary) {
      if (line.find(part) != std::string::npos) return testing::AssertionSuccess();
      all += line + "\n";
    }
    return testing::AssertionFailure() << "\"" << part << "\" is not in\n" << all;
  }

  TempDir folder_;
  SceneOptions options_;
};

TEST_F(LoadScene, GivesViewsSortedByNameWithTheirImages) {
  write_scene(3);
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 3u);
  EXPECT_TRUE(scene.test.empty());
  for (int i = 0; i < 3; ++i) {
    const View& view = scene.train[i];
    EXPECT_EQ(view.name, numbered_name(i));
    EXPECT_EQ(view.camera.cam_from_world.translation[0], -i);
    ASSERT_NE(view.image, nullptr);
    EXPECT_EQ(view.image->read()->pixels[0], 100 + i);
    EXPECT_EQ(view.valid, nullptr);
    EXPECT_EQ(view.camera.width, kWidth);
    EXPECT_EQ(view.camera.fx, 50);
    EXPECT_EQ(view.camera.fy, 60);
    EXPECT_EQ(view.camera.cx, 21);
    EXPECT_EQ(view.camera.cy, 14);
  }
  EXPECT_EQ(scene.points.positions, (std::vector<float>{1, 2, 3}));
  EXPECT_EQ(scene.points.colors, (std::vector<std::uint8_t>{10, 20, 30}));
  EXPECT_TRUE(says(scene, "3 registered, 3 found"));
}

TEST_F(LoadScene, ListsTheVisiblePointsOfEachViewIfTracksAreRead) {
  const ColmapModel model = line_model(3);
  write_colmap_model(folder_ / "sparse/0", model, ColmapFormat::kText);
  write_images(model);
  write_bytes(folder_ / "sparse/0/points3D.txt",
              "7 0 0 1 9 9 9 0.1 100 0 102 5\n"
              "5 0 0 2 9 9 9 0.1 102 1 102 3 100 8\n"
              "9 0 0 3 9 9 9 0.1 4711 1\n");
  EXPECT_TRUE(load().train[0].points.empty());
  options_.tracks = true;
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].points, (std::vector<std::int32_t>{0, 1}));
  EXPECT_TRUE(scene.train[1].points.empty());
  EXPECT_EQ(scene.train[2].points, (std::vector<std::int32_t>{0, 1}));
}

TEST_F(LoadScene, HoldsOutEveryEighthBySortedName) {
  write_scene(17);
  options_.eval = true;
  const Scene scene = load();
  ASSERT_EQ(scene.test.size(), 3u);
  EXPECT_EQ(scene.test[0].name, "00.png");
  EXPECT_EQ(scene.test[1].name, "08.png");
  EXPECT_EQ(scene.test[2].name, "16.png");
  EXPECT_EQ(scene.train.size(), 14u);
  // Centres 1..7 and 9..15 on a line: their mean is 8, the farthest are 7 away.
  EXPECT_DOUBLE_EQ(scene.extent, 1.1 * 7);
  EXPECT_TRUE(says(scene, "3 views, every 8th"));
}

TEST_F(LoadScene, HoldsOutWhatATestListNames) {
  write_scene(9);
  const auto names = [](const std::vector<View>& views) {
    std::string text;
    for (const View& view : views) text += view.name + " ";
    return text;
  };
  for (const char* file : {"test.txt", "sparse/test.txt", "sparse/0/test.txt"}) {  // each comes before the last
    const std::string digit = std::to_string(fs::path(file).string().size() % 5);
    write_bytes(folder_ / file, "\xef\xbb\xbf 0" + digit + ".png \r\n\n# a comment\n08\n");
    options_.eval = false;
    EXPECT_EQ(load().train.size(), 9u);
    EXPECT_TRUE(says(load(), std::string("none; --eval holds out the views of ") + file));
    options_.eval = true;
    const Scene scene = load();
    EXPECT_EQ(names(scene.test), "0" + digit + ".png 08.png ");
    EXPECT_EQ(scene.train.size(), 7u);
    EXPECT_TRUE(scene.warnings.empty());
    EXPECT_TRUE(says(scene, std::string("2 views, the views of ") + file));
  }
  write_bytes(folder_ / "sparse/0/test.txt", "gone.png\n03.png\n");
  const Scene scene = load();
  EXPECT_EQ(names(scene.test), "03.png ");
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("test.txt: 1 of 2 names are unknown (the first: gone.png)"), std::string::npos);
  write_bytes(folder_ / "sparse/0/test.txt", "gone.png\n");
  EXPECT_TRUE(refuses({"sparse/0/test.txt: expected names as in the model, found none in its 1 (first: gone.png)"}));
  options_.needs_training_views = false;
  EXPECT_TRUE(says(load(), "every 8th by name")) << "an evaluation uses the views of the training";
  EXPECT_NE(load().warnings.at(0).find("sparse/0/test.txt is ignored: expected names as"), std::string::npos);
  options_.needs_training_views = true;
  write_bytes(folder_ / "sparse/0/test.txt", "\n");
  EXPECT_TRUE(says(load(), "every 8th by name"));
}

TEST_F(LoadScene, IgnoresATestListThatNamesNoImage) {
  write_scene(9);
  options_.eval = true;
  for (const char* name : {"sparse/test.txt", "test.txt"}) {
    write_bytes(folder_ / name, "milk\nbread\n");
    const Scene scene = load();
    EXPECT_EQ(scene.test.size(), 2u) << name;
    EXPECT_TRUE(says(scene, "every 8th by name"));
    ASSERT_EQ(scene.warnings.size(), 1u);
    EXPECT_NE(scene.warnings[0].find(std::string(name) + " is ignored: expected names as in the model, found none in "
                                                         "its 2 (first: bread)"),
              std::string::npos)
        << scene.warnings[0];
    options_.eval = false;
    EXPECT_TRUE(load().warnings.empty());
    EXPECT_TRUE(says(load(), "none; --eval holds out every 8th"));
    options_.eval = true;
    fs::remove(folder_ / name);
  }
}

TEST_F(LoadScene, ATestListMayNameFilesAsOtherProgramsDo) {
  write_scene(9);
  options_.eval = true;
  for (const char* name : {"images/03.png", "images\\03.png", "03.PNG", "03.JPG",
                           "\xef\xbb\xbf"
                           "03.png"}) {
    write_bytes(folder_ / "sparse/0/test.txt", std::string(name) + "\n");
    const Scene scene = load();
    ASSERT_EQ(scene.test.size(), 1u) << name;
    EXPECT_EQ(scene.test[0].name, "03.png") << name;
    EXPECT_TRUE(scene.warnings.empty()) << name;
  }
}

TEST_F(LoadScene, LimitsTheExtentIfACameraIsFarAndNamesIt) {
  ColmapModel model = line_model(9);
  model.images[0].translation[0] = -1000;  // 08.png
  write(model);
  write_images(model);
  const Scene scene = load();
  EXPECT_DOUBLE_EQ(scene.extent, 1.1 * kMostRadius * 4);  // the others are at most 4 from the median, 4
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("the camera of 08.png is 249 times as far from the others as usual; the radius"),
            std::string::npos)
      << scene.warnings[0];
}

TEST_F(LoadScene, RejectsToHoldOutTheOnlyImage) {
  write_scene(1);
  EXPECT_EQ(load().extent, 1);  // one camera has no distances
  options_.eval = true;
  EXPECT_TRUE(refuses({"--eval", "leaves none"}));
}

TEST_F(LoadScene, HoldsOutTheOnlyImageForAnEvaluation) {
  write_scene(1);
  options_.eval = true;
  options_.needs_training_views = false;
  const Scene scene = load();
  EXPECT_TRUE(scene.train.empty());
  ASSERT_EQ(scene.test.size(), 1u);
  EXPECT_EQ(scene.test[0].image->read()->pixels[0], 100);
}

TEST_F(LoadScene, ScalesIntrinsicsPerAxisToTheImageOnDisk) {
  write(line_model(1));
  write_images(line_model(1), "images", 20, 10);
  const Camera camera = load().train[0].camera;
  EXPECT_EQ(camera.width, 20);
  EXPECT_EQ(camera.height, 10);
  EXPECT_DOUBLE_EQ(camera.fx, 25);
  EXPECT_DOUBLE_EQ(camera.fy, 20);
  EXPECT_DOUBLE_EQ(camera.cx, 10.5);
  EXPECT_DOUBLE_EQ(camera.cy, 14.0 / 3);
  EXPECT_TRUE(says(load(), "aspect ratio differs from the camera's"));
}

TEST_F(LoadScene, ReducesImagesAndCamerasForTraining) {
  write_scene(1);
  options_.resolution = 4;
  const View view = load().train[0];
  EXPECT_EQ(view.camera.width, 10);
  EXPECT_EQ(view.camera.height, 8);  // 7.5
  EXPECT_EQ(view.image->size().width, 10);
  EXPECT_EQ(view.image->size().height, 8);
  EXPECT_DOUBLE_EQ(view.camera.fx, 12.5);
  EXPECT_DOUBLE_EQ(view.camera.fy, 16);
  options_.resolution = 0;
  EXPECT_TRUE(refuses({"-r 0"}));
}

TEST_F(LoadScene, ReducesImagesIfTheReducedFolderIsMissing) {
  write_scene(1);
  options_.images = "images_2";
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].image->size().width, 20);
  EXPECT_EQ(scene.train[0].image->size().height, 15);
  EXPECT_DOUBLE_EQ(scene.train[0].camera.fx, 25);
  EXPECT_TRUE(says(scene, "images_2/ not found"));
}

TEST_F(LoadScene, UsesAnExistingReducedFolderUnchanged) {
  write_scene(1);
  write_images(line_model(1), "images_2", 21, 15);
  options_.images = "images_2";
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].image->size().width, 21);
  EXPECT_DOUBLE_EQ(scene.train[0].camera.fx, 50 * 21.0 / 40);
}

TEST_F(LoadScene, ListsTheFoldersWhenTheImageFolderIsMissing) {
  write_scene(1);
  options_.images = "photos";
  EXPECT_TRUE(refuses({"photos", "image folder not found", "images, sparse", "-i"}));
}

TEST_F(LoadScene, CountsMissingAndUnregisteredImages) {
  write_scene(4);
  fs::remove(folder_ / "images/01.png");
  fs::remove(folder_ / "images/03.png");
  write_image(folder_ / "images/other.jpg", flat(4, 4, 3, 0));
  write_bytes(folder_ / "images/notes.txt", "no image");
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 2u);
  EXPECT_EQ(scene.train[1].name, "02.png");
  EXPECT_TRUE(says(scene, "4 registered, 2 found"));
  EXPECT_TRUE(says(scene, "2 missing (01.png, 03.png)"));
  EXPECT_TRUE(says(scene, "1 more not in the model"));
}

TEST_F(LoadScene, RejectsASceneWithoutPhotographs) {
  write(line_model(3));
  EXPECT_TRUE(refuses({(folder_ / "images").string(), "none of the 3 registered images", "00.png"}));
  fs::create_directories(folder_ / "images");
  EXPECT_TRUE(refuses({(folder_ / "images").string(), "none of the 3 registered images"}));
  ColmapModel empty = line_model(0);
  write(empty);
  EXPECT_TRUE(refuses({"no registered images"}));
}

TEST_F(LoadScene, FindsImagesUnderTheNamesThatToolsGiveThem) {
  ColmapModel model = line_model(4);
  model.images[0].name = "images/prefixed.png";
  model.images[1].name = "left/deep.png";
  model.images[2].name = "shot.JPG";
  model.images[3].name = "cam1/flat.png";
  write(model);
  for (const char* name : {"prefixed.png", "left/deep.png", "shot.png", "flat.png"}) {
    write_image(folder_ / "images" / name, flat(kWidth, kHeight, 3, 1));
  }
  const Scene scene = load();
  EXPECT_EQ(scene.train.size(), 4u);
  EXPECT_TRUE(says(scene, "found under another name: cam1/flat.png as flat.png, shot.JPG as shot.png"));
}

TEST_F(LoadScene, FindsNamesInAnotherUnicodeForm) {
  const std::string decomposed = "Bu\xcc\x88ro", composed = "B\xc3\xbcro";  // with and without a combining mark
  ColmapModel model = line_model(3);
  for (const bool is_model_composed : {false, true}) {
    const std::string &named = is_model_composed ? composed : decomposed,
                      &other = is_model_composed ? decomposed : composed;
    remove_tree(folder_ / "images");
    remove_tree(folder_ / "masks");
    for (int i = 0; i < 3; ++i) {
      const std::string end = "/" + named + std::to_string(i) + ".png";
      model.images[i].name = named + end;
      write_image(folder_ / "images" / other / (other + std::to_string(i) + ".png"), flat(kWidth, kHeight, 3, 70 + i));
    }
    Image8 mask = flat(kWidth, kHeight, 1, 255);
    mask.pixels[0] = 0;
    write_image(folder_ / "masks" / other / (other + "1.png"), mask);
    write(model);
    write_bytes(folder_ / "sparse/0/test.txt", other + "/" + other + "2\n");
    options_.eval = true;
    const Scene scene = load();
    ASSERT_EQ(scene.train.size(), 2u);
    EXPECT_EQ(scene.train[1].image->read()->pixels[0], 71);
    EXPECT_NE(scene.train[1].valid, nullptr);
    ASSERT_EQ(scene.test.size(), 1u);
    EXPECT_EQ(scene.test[0].image->read()->pixels[0], 72);
    EXPECT_TRUE(scene.warnings.empty());
    EXPECT_TRUE(says(scene, "0.png as the same in another Unicode form"));
  }
  model.images[0].name = "caf\xe9.png";  // Latin-1
  write_image(folder_ / "images" / "CAF\xe9.jpg", flat(kWidth, kHeight, 3, 9));
  write(model);
  EXPECT_EQ(load().train.size() + load().test.size(), 3u) << "bytes that are not UTF-8 are compared as they are";
}

TEST_F(LoadScene, DoesNotUseAnImageOfAnotherSubfolder) {
  ColmapModel model = line_model(2);
  model.images[0].name = "left/a.png";
  model.images[1].name = "right/a.png";
  write(model);
  write_image(folder_ / "images/left/a.png", flat(kWidth, kHeight, 3, 1));
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 1u);
  EXPECT_EQ(scene.train[0].name, "left/a.png");
  EXPECT_TRUE(says(scene, "1 missing (right/a.png)"));
}

TEST_F(LoadScene, RejectsTwoNamesThatMatchOneFile) {
  ColmapModel model = line_model(2);
  model.images[0].name = "left/a.png";
  model.images[1].name = "right/a.png";
  write(model);
  write_image(folder_ / "images/a.png", flat(kWidth, kHeight, 3, 1));
  EXPECT_TRUE(refuses({"images/a.png", "left/a.png", "right/a.png", "both match only this file"}));
}

TEST_F(LoadScene, SearchesTheSceneFolderIfThereIsNoImageFolder) {
  ColmapModel model = line_model(1);
  model.images[0].name = "left/a.png";
  write(model);
  write_image(folder_ / "left/a.png", flat(kWidth, kHeight, 3, 1));
  EXPECT_TRUE(says(load(), "images/ not found: searching the scene folder itself"));
}

TEST_F(LoadScene, ChoosesTheModelWithTheMostImages) {
  write_scene(5);
  write(line_model(2), "sparse/0");
  write(line_model(5), "sparse/10");
  write(line_model(4), "sparse/2");
  const Scene scene = load();
  EXPECT_EQ(scene.train.size(), 5u);
  EXPECT_TRUE(
      says(scene, "3 models: using sparse/10, which has the most images (5); ignoring sparse/0 (2), sparse/2 (4)"));
}

TEST_F(LoadScene, FindsAModelOutsideANumberedFolder) {
  write_images(line_model(2));
  write(line_model(2), "sparse");
  EXPECT_EQ(load().train.size(), 2u);
  remove_tree(folder_ / "sparse");
  EXPECT_TRUE(
      refuses({folder_.path().string(), "sparse/0", "no COLMAP model found", "b3dgs reconstruct PHOTOS SCENE"}));
  write(line_model(2), "");
  EXPECT_EQ(load().train.size(), 2u);
}

TEST_F(LoadScene, NamesAMissingSceneFolder) {
  options_.source_path = (folder_ / "nowhere").string();
  EXPECT_TRUE(refuses({"nowhere", "scene folder not found"}));
}

TEST_F(LoadScene, RejectsACorruptImageByName) {
  write_scene(6);
  const std::string whole = test::read_bytes(folder_ / "images/04.png");
  write_bytes(folder_ / "images/04.png", whole.substr(0, whole.size() - 15));
  const Scene scene = load();
  EXPECT_EQ(scene.train[3].image->read()->pixels[0], 103);
  EXPECT_TRUE(fails_with<InputError>({"04.png", "ends before"}, [&] { scene.train[4].image->read(); }));
  EXPECT_TRUE(fails_with<InputError>({"04.png", "ends before"}, [&] { hold_images(scene.train, {}); }));
  EXPECT_EQ(scene.train[4].image->held(), nullptr);
}

TEST_F(LoadScene, ReportsProgressUpToTheLastImage) {
  write_scene(9);
  std::vector<std::size_t> seen;
  load_scene(options_, [&](const std::string&, std::size_t done, std::size_t total) {
    EXPECT_EQ(total, 9u);
    seen.push_back(done);
  });
  ASSERT_EQ(seen.size(), 9u);
  for (std::size_t i = 0; i < seen.size(); ++i) EXPECT_EQ(seen[i], i + 1);
}

TEST_F(LoadScene, WithoutImagesReadsOnlyTheirHeaders) {
  write_scene(1);
  const std::string whole = test::read_bytes(folder_ / "images/00.png");
  write_bytes(folder_ / "images/00.png", whole.substr(0, 40));
  options_.load_images = false;
  options_.resolution = 2;
  const View view = load().train[0];
  EXPECT_EQ(view.image, nullptr);
  EXPECT_EQ(view.camera.width, 20);
  EXPECT_EQ(view.camera.height, 15);
}

TEST_F(LoadScene, UndistortsAndSharesTheMask) {
  ColmapModel model = line_model(3);
  model.cameras[1] = {1, CameraModel::kSimpleRadial, 400, 300, {400, 200, 150, 0.4}};
  write(model);
  for (const ColmapImage& image : model.images) write_image(folder_ / "images" / image.name, flat(400, 300, 3, 200));
  options_.resolution = 2;
  const Scene scene = load();
  const View& view = scene.train[0];
  EXPECT_EQ(view.camera.width, 200);
  EXPECT_DOUBLE_EQ(view.camera.fx, 200);
  EXPECT_DOUBLE_EQ(view.camera.cx, 100);
  ASSERT_NE(view.valid, nullptr);
  EXPECT_EQ(view.valid, scene.train[2].valid);
  EXPECT_EQ(view.valid->width, 200);
  EXPECT_EQ(view.valid->height, 150);
  const auto image = view.image->read();
  std::size_t n_valid = 0;
  for (std::size_t i = 0; i < view.valid->pixels.size(); ++i) {
    if (view.valid->pixels[i] == 0) continue;
    ++n_valid;
    ASSERT_EQ(image->pixels[3 * i], 200) << "a valid pixel contains black from outside the photograph";
  }
  EXPECT_GT(n_valid, view.valid->pixels.size() / 2);
  EXPECT_LT(n_valid, view.valid->pixels.size());
  EXPECT_TRUE(says(scene, "removed from 3 images"));
}

TEST_F(LoadScene, ACameraAbsurdlyFarFromTheOthersIsRefused) {
  ColmapModel model = line_model(5);
  write_images(model);
  model.images[1].translation[1] = 300;
  write(model);
  EXPECT_EQ(load().train.size(), 5u);
  model.images[1].translation[1] = 1e9;
  write(model);
  EXPECT_TRUE(refuses({"sparse/0/images.bin: image 03.png: expected a camera centre at most", "remove the image"}));
}

TEST_F(LoadScene, LeavesOutImagesWithoutAUsablePose) {
  ColmapModel model = line_model(5);
  write_images(model);
  model.images[1].translation[1] = std::nan("");
  write(model);
  const Scene scene = load();
  EXPECT_EQ(scene.train.size(), 4u);
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("images.bin: image 103 (03.png): expected a translation"), std::string::npos);
  EXPECT_NE(scene.warnings[0].find("leave out 1 of 5 images (first: 03.png)"), std::string::npos) << scene.warnings[0];
}

TEST_F(LoadScene, WarnsOfPointsThatAreNotFinite) {
  ColmapModel model = line_model(3);
  write_images(model);
  ASSERT_EQ(model.points.size(), 1u);
  model.points.push_back({77, {0, std::nan(""), 0}, {1, 2, 3}, 0});
  write(model);
  const Scene scene = load();
  EXPECT_EQ(scene.points.size(), 1);
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("points3D.bin: point 77: expected"), std::string::npos) << scene.warnings[0];
  EXPECT_NE(scene.warnings[0].find("1 of 2 points are left out"), std::string::npos) << scene.warnings[0];
}

TEST_F(LoadScene, ReadsPointsInTheOtherFormat) {
  const ColmapModel model = line_model(3);
  write_images(model);
  options_.seed_points = true;
  for (const auto& [format, other, own_file, other_file] :
       {std::tuple{ColmapFormat::kBinary, ColmapFormat::kText, "points3D.bin", "points3D.txt"},
        {ColmapFormat::kText, ColmapFormat::kBinary, "points3D.txt", "points3D.bin"}}) {
    remove_tree(folder_ / "sparse");
    write_colmap_model(folder_ / "other", model, other);
    write_colmap_model(folder_ / "sparse/0", model, format);
    fs::remove(folder_ / "sparse/0" / own_file);
    fs::rename(folder_ / "other" / other_file, folder_ / "sparse/0" / other_file);
    const Scene scene = load();
    EXPECT_EQ(scene.points.size(), 1) << other_file;
    EXPECT_TRUE(says(scene, std::string("1: ") + other_file));
  }
}

TEST_F(LoadScene, ReadsPointsFromAPlyBesideTheModel) {
  const PointCloud points{{0, 1, 2, 3, 4, 5}, {10, 20, 30, 40, 50, 60}};
  const ColmapModel model = line_model(3);
  write_images(model);
  for (const auto format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    remove_tree(folder_ / "sparse");
    write_colmap_model(folder_ / "sparse/0", model, format);
    write_point_ply(folder_ / "sparse/0/points3D.ply", points);
    EXPECT_EQ(load().points.size(), 1) << "COLMAP's own points come first";
    const std::string file = format == ColmapFormat::kBinary ? "points3D.bin" : "points3D.txt";
    fs::remove(folder_ / "sparse/0" / file);
    options_.seed_points = true;
    const Scene scene = load();
    EXPECT_EQ(scene.points.positions, points.positions);
    EXPECT_EQ(scene.points.colors, points.colors);
    EXPECT_TRUE(says(scene, "2: points3D.ply"));
    fs::remove(folder_ / "sparse/0/points3D.ply");
    EXPECT_TRUE(refuses({"sparse/0/" + file + ": file not found", "--init_ply"}));
    options_.seed_points = false;  // as with --init_ply
    EXPECT_EQ(load().points.size(), 0);
    EXPECT_EQ(load().train.size(), 3u);
  }
}

TEST_F(LoadScene, ReadsPastRigsAndFrames) {
  write_scene(2);
  write_bytes(folder_ / "sparse/0/rigs.bin", "of COLMAP 3.12 and later");
  write_bytes(folder_ / "sparse/0/frames.bin", "");
  EXPECT_EQ(load().train.size(), 2u);
}

TEST_F(LoadScene, MixesSizesAndOrientations) {
  ColmapModel model = line_model(2);
  model.cameras[2] = {2, CameraModel::kPinhole, kHeight, kWidth, {50, 50, 15, 20}};
  model.images[0].camera_id = 2;
  write(model);
  write_image(folder_ / "images/00.png", flat(kWidth, kHeight, 3, 1));
  write_image(folder_ / "images/01.png", flat(kHeight, kWidth, 3, 2));
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].camera.width, kWidth);
  EXPECT_EQ(scene.train[1].camera.width, kHeight);
  EXPECT_EQ(scene.train[1].image->size().height, kWidth);
}

// A camera of 24 x 36 px, and photographs of 36 x 24 px.
TEST_F(LoadScene, TurnsPhotographsWhoseSidesAreSwappedAsExifSays) {
  ColmapModel model = line_model(8);
  model.cameras[1] = {1, CameraModel::kPinhole, 24, 36, {50, 60, 13, 17}};
  for (ColmapImage& image : model.images) image.name = std::to_string(image.id - 99) + ".jpg";  // the orientation
  write(model);
  Image8 mask(36, 24, 1);
  mask.pixels.assign(mask.pixels.size(), 255);
  *mask.at(0, 0) = 0;
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const std::vector<std::uint8_t> jpeg = test::jpeg_with_orientation(36, 24, orientation, orientation % 2 == 0);
    write_bytes(folder_ / ("images/" + std::to_string(orientation) + ".jpg"), std::string(jpeg.begin(), jpeg.end()));
    write_image(folder_ / ("masks/" + std::to_string(orientation) + ".png"), mask);
  }
  for (const int divisor : {1, 2}) {
    options_.resolution = divisor;
    const Scene scene = load();
    ASSERT_EQ(scene.train.size(), 8u);
    for (int orientation = 5; orientation <= 8; ++orientation) {
      const View& view = scene.train[orientation - 1];
      EXPECT_EQ(view.camera.width, 24 / divisor);
      EXPECT_EQ(view.camera.fx, 50.0 / divisor);
      EXPECT_EQ(view.camera.cy, 17.0 / divisor);
      // OpenCV turns it, like viewers.
      const cv::Mat expected = cv::imread(view.file, cv::IMREAD_COLOR);
      ASSERT_EQ(expected.size(), cv::Size(24, 36));
      if (divisor > 1) continue;
      const Image8 image = *view.image->read();
      for (int y = 0; y < 36; ++y) {
        for (int x = 0; x < 24; ++x) ASSERT_EQ(image.at(x, y)[0], expected.at<cv::Vec3b>(y, x)[2]) << orientation;
      }
      // The corner of the mask moves like the bright corner of the photograph.
      for (const int y : {0, 35}) {
        for (const int x : {0, 23}) {
          EXPECT_EQ(*view.valid->at(x, y) == 0, image.at(x, y)[1] > 150) << orientation << " " << x << " " << y;
        }
      }
    }
    for (int orientation = 1; orientation <= 4; ++orientation) {
      EXPECT_EQ(scene.train[orientation - 1].camera.width, 36 / divisor) << "nothing says how to turn it";
    }
    EXPECT_TRUE(says(scene, "turned as their EXIF orientation says"));
    ASSERT_EQ(scene.warnings.size(), 1u);
    EXPECT_NE(scene.warnings[0].find("images/1.jpg: expected the sides of its camera, 24 x 36 px, found 36 x 24 px"),
              std::string::npos)
        << scene.warnings[0];
    EXPECT_NE(scene.warnings[0].find("(4 such photographs); turn"), std::string::npos) << scene.warnings[0];
  }
  // The camera's sides show that the photographs are used as stored.
  model.cameras[1] = {1, CameraModel::kPinhole, 36, 24, {50, 60, 17, 13}};
  write(model);
  options_.resolution = 1;
  const Scene scene = load();
  EXPECT_TRUE(scene.warnings.empty());
  EXPECT_EQ(scene.train[5].image->size(), (ImageSize{36, 24}));
}

TEST_F(LoadScene, FindsPointsInThePhotographsIfTheModelHasNone) {
  ColmapModel model = line_model(1);
  model.points.clear();
  write(model);
  write_images(model);
  const Scene scene = load();
  EXPECT_EQ(scene.points.size(), 0);
  EXPECT_TRUE(says(scene, "the scene has no points"));
  options_.seed_points = true;
  const Scene found = load();
  EXPECT_GT(found.points.size(), 0);
  EXPECT_TRUE(says(found, "found in the photographs"));
  EXPECT_EQ(found.n_added_points, 0) << "none beside others";
}

}  // namespace
}  // namespace b3dgs
