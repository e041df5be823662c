#include "scene/transforms/transforms.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/files/folders.h"
#include "scene/images/image.h"
#include "scene/photograph.h"
#include "scene/points/point_cloud.h"
#include "scene/scene_folder.h"
#include "scene/view_image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/formats/write_transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::flat;
using test::Json;
using test::kHeight;
using test::kWidth;
using test::write_bytes;

std::string image_name(int i) {
  return (i < 10 ? "0" : "") + std::to_string(i) + ".png";
}

class Transforms : public test::SceneFolder {
 protected:
  // Returns a camera at (i, 0, 0) that looks along -z. The grey value of its photograph is 10 + i.
  Json frame(int i, const std::string& file_path) {
    return {{"file_path", file_path}, {"transform_matrix", {{1, 0, 0, i}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}}};
  }
  void write_photograph(const fs::path& path, int i) { write_image(folder_ / path, flat(kWidth, kHeight, 3, 10 + i)); }

  // Returns n frames images/00.png, ... with intrinsics for the whole file.
  Json line(int n) {
    Json json{{"fl_x", 50.0}, {"fl_y", 60.0}, {"cx", 21.0}, {"cy", 14.0}, {"w", kWidth}, {"h", double{kHeight}}};
    json["frames"] = Json::array();
    for (int i = 0; i < n; ++i) {
      json["frames"].push_back(frame(i, "./images/" + image_name(i)));
      write_photograph("images/" + image_name(i), i);
    }
    return json;
  }
  void write(const Json& json, const std::string& name = "transforms.json") {
    write_bytes(folder_ / name, json.dump(1));
  }
  testing::AssertionResult refuses(const Json& json, std::initializer_list<std::string> parts) {
    write(json);
    return SceneFolder::refuses(parts);
  }
};

TEST_F(Transforms, GivesViewsSortedByNameWithIntrinsicsOfTheFile) {
  Json json = line(3);
  std::reverse(json["frames"].begin(), json["frames"].end());
  write(json);
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    const View& view = scene.train[static_cast<std::size_t>(i)];
    EXPECT_EQ(view.name, "images/" + image_name(i));
    EXPECT_EQ(view.image->read()->pixels[0], 10 + i);
    EXPECT_EQ(view.camera.fx, 50);
    EXPECT_EQ(view.camera.fy, 60);
    EXPECT_EQ(view.camera.cx, 21);
    EXPECT_EQ(view.camera.cy, 14);
    EXPECT_NEAR(view.camera.center()[0], i, 1e-15);
    // -z of OpenGL is +z of this program, and +y is -y.
    const std::array<double, 9> expected{1, 0, 0, 0, -1, 0, 0, 0, -1};
    for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(view.camera.cam_from_world.rotation[k], expected[k], 1e-15);
    EXPECT_EQ(view.valid, nullptr);
  }
  EXPECT_TRUE(says(scene, "transforms.json"));
  EXPECT_TRUE(says(scene, "3 registered, 3 found"));
  EXPECT_TRUE(says(scene, "1: PINHOLE 40x30"));
}

TEST_F(Transforms, GivesTheCamerasOfTheSameColmapModel) {
  ColmapModel model;
  const std::vector<ColmapCamera> cameras{
      {1, CameraModel::kPinhole, kWidth, kHeight, {50.25, 60.5, 21.125, 14}},
      {2, CameraModel::kOpenCv, kWidth, kHeight, {50, 60, 21, 14, 0.1, -0.02, 0.003, 0.001}},
      {3, CameraModel::kOpenCvFisheye, kWidth, kHeight, {30, 31, 20, 15, 0.01, 0.02, -0.003, 0.004}},
      {4, CameraModel::kSimpleRadial, kWidth, kHeight, {50, 21, 14, 0.05}},
      {5,
       CameraModel::kFullOpenCv,
       kWidth,
       kHeight,
       {50, 60, 21, 14, 0.1, -0.02, 0.003, 0.001, 0.2, 0.01, 0.02, 0.03}}};
  for (const ColmapCamera& camera : cameras) {
    const double i = camera.id;
    model.cameras[camera.id] = camera;
    model.images.push_back({camera.id, {0.5, 0.1 * i, -0.3, 0.2 * i}, {i, -2, 0.5}, camera.id, image_name(camera.id)});
    write_image(folder_ / "images" / image_name(camera.id), flat(kWidth, kHeight, 3, 200));
  }
  write_colmap_model(folder_ / "sparse/0", model, ColmapFormat::kText);
  const Scene colmap = load();
  fs::rename(folder_ / "sparse", folder_ / "not_searched");
  write(test::transforms_of(model));
  const Scene transforms = load();
  ASSERT_EQ(transforms.train.size(), colmap.train.size());
  for (std::size_t i = 0; i < colmap.train.size(); ++i) {
    const View &a = colmap.train[i], &b = transforms.train[i];
    EXPECT_EQ("images/" + a.name, b.name);
    EXPECT_EQ(a.camera.fx, b.camera.fx);
    EXPECT_EQ(a.camera.fy, b.camera.fy);
    EXPECT_EQ(a.camera.cx, b.camera.cx);
    EXPECT_EQ(a.camera.cy, b.camera.cy);
    for (std::size_t k = 0; k < 9; ++k) {
      EXPECT_NEAR(a.camera.cam_from_world.rotation[k], b.camera.cam_from_world.rotation[k], 1e-12);
    }
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_NEAR(a.camera.cam_from_world.translation[k], b.camera.cam_from_world.translation[k], 1e-12);
    }
    EXPECT_EQ(a.image->read()->pixels, b.image->read()->pixels) << a.name;
    ASSERT_EQ(a.valid == nullptr, b.valid == nullptr) << a.name;
    if (a.valid) {
      EXPECT_EQ(a.valid->pixels, b.valid->pixels);
    }
  }
}

// The files resemble NeRF's synthetic scenes: no extensions, no sizes, RGBA, a file for each part.
TEST_F(Transforms, ReadsTheFormOfSyntheticNerfScenes) {
  const auto part = [&](const std::string& name, int n) {
    Json json{{"camera_angle_x", 0.6911112070083618}, {"frames", Json::array()}};
    for (int i = 0; i < n; ++i) {
      Json entry = frame(i, "./" + name + "/r_" + std::to_string(i));
      entry["rotation"] = 0.0125;
      json["frames"].push_back(entry);
      write_photograph(name + "/r_" + std::to_string(i) + ".png", i);
    }
    write(json, "transforms_" + name + ".json");
  };
  part("train", 4);
  part("val", 2);
  Scene scene = load();
  EXPECT_EQ(scene.train.size(), 4u);
  EXPECT_EQ(scene.test.size(), 0u);
  EXPECT_TRUE(says(scene, "none; --eval holds out the views of transforms_val.json"));
  const Camera camera = scene.train[0].camera;
  EXPECT_EQ(camera.width, kWidth);
  EXPECT_NEAR(camera.fx, 0.5 * kWidth / std::tan(0.5 * 0.6911112070083618), 1e-12);
  EXPECT_EQ(camera.fy, camera.fx);
  EXPECT_EQ(camera.cx, 0.5 * kWidth);
  EXPECT_EQ(camera.cy, 0.5 * kHeight);

  options_.eval = true;
  scene = load();
  EXPECT_EQ(scene.train.size(), 4u);
  ASSERT_EQ(scene.test.size(), 2u);
  EXPECT_EQ(scene.test[0].name, "val/r_0.png");

  part("test", 3);
  scene = load();
  ASSERT_EQ(scene.test.size(), 3u);
  EXPECT_EQ(scene.test[2].name, "test/r_2.png");
  EXPECT_TRUE(says(scene, "3 views, the views of transforms_test.json"));
  EXPECT_TRUE(says(scene, "transforms_val.json is not used"));
}

TEST_F(Transforms, HoldsOutWhatTheFileListsOrElseEveryEighth) {
  Json json = line(9);
  write(json);
  options_.eval = true;
  EXPECT_EQ(load().test.size(), 2u);
  json["val_filenames"] = {"images/02.png", "images/03.png", "images/04.png"};
  write(json);
  EXPECT_EQ(load().test.size(), 3u);
  json["test_filenames"] = {"./images/05.png"};
  write(json);
  const Scene scene = load();
  ASSERT_EQ(scene.test.size(), 1u);
  EXPECT_EQ(scene.test[0].name, "images/05.png");
  EXPECT_TRUE(says(scene, "test_filenames of transforms.json"));
}

TEST_F(Transforms, TrainsOnNoViewThatTheFileListsForValidation) {
  Json json = line(9);
  json["test_filenames"] = {"images/05.png", "images/gone.png"};
  json["val_filenames"] = {"images/02.png", "images/03.png", "images/05.png"};
  write(json);
  EXPECT_EQ(load().train.size(), 9u);
  options_.eval = true;
  const Scene scene = load();
  ASSERT_EQ(scene.test.size(), 1u);
  EXPECT_EQ(scene.test[0].name, "images/05.png");
  ASSERT_EQ(scene.train.size(), 6u);
  for (const View& view : scene.train) EXPECT_TRUE(view.name != "images/02.png" && view.name != "images/03.png");
  EXPECT_TRUE(says(scene, "only in val_filenames, so neither trained on nor tested: 2 views"));
}

TEST_F(Transforms, LeavesOutWhatNoListNamesIfOneSaysWhatToTrainOn) {
  Json json = line(12);
  for (int i = 1; i < 10; ++i) json["train_filenames"].push_back("./images/" + image_name(i));
  write(json);
  EXPECT_EQ(load().train.size(), 9u);
  EXPECT_TRUE(says(load(), "left out, in neither train_filenames"));
  options_.eval = true;
  Scene scene = load();
  ASSERT_EQ(scene.test.size(), 2u) << "every 8th of the others";
  EXPECT_EQ(scene.test[1].name, "images/09.png");
  json["val_filenames"] = {"images/10.png"};
  json["test_filenames"] = {"images/00.png", "images/09.png"};
  write(json);
  scene = load();
  ASSERT_EQ(scene.test.size(), 2u);
  EXPECT_EQ(scene.test[0].name, "images/00.png");
  EXPECT_EQ(scene.train.size(), 8u);
  EXPECT_EQ(scene.train.back().name, "images/08.png");
  options_.eval = false;
  EXPECT_EQ(load().train.size(), 11u);
  json["train_filenames"] = {"images/03.png", "images/gone.png"};
  write(json);
  EXPECT_EQ(load().warnings.size(), 1u);
  json["train_filenames"] = {"images/gone.png"};
  EXPECT_TRUE(refuses(json, {"transforms.json: train_filenames", "found none in its 1", "images/gone.png"}));
}

TEST_F(Transforms, AListThatMatchesNoFrameIsAnError) {
  for (const char* key : {"test_filenames", "val_filenames"}) {
    Json json = line(9);
    json[key] = {"photos/05.png", "photos/06.png"};
    write(json);
    options_.eval = false;
    EXPECT_EQ(load().train.size(), 9u);
    options_.eval = true;
    EXPECT_TRUE(
        fails_with<InputError>({"transforms.json: ", key, "found none in its 2", "photos/05.png"}, [&] { load(); }));
  }
}

TEST_F(Transforms, WhereAllAreHeldOutAllAreTrainedOnWithoutEval) {
  Json json = line(2);
  json["test_filenames"] = {"images/00.png", "images/01.png"};
  write(json);
  EXPECT_EQ(load().train.size(), 2u);
  options_.eval = true;
  EXPECT_THROW(load(), InputError);
}

TEST_F(Transforms, KeysOfAFrameComeBeforeThoseOfTheFile) {
  Json json = line(2);
  json["frames"][1]["fl_x"] = 70;
  json["frames"][1]["cx"] = 19.5;
  write(json);
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].camera.fx, 50);
  EXPECT_EQ(scene.train[1].camera.fx, 70);
  EXPECT_EQ(scene.train[1].camera.fy, 60);
  EXPECT_EQ(scene.train[1].camera.cx, 19.5);
  EXPECT_TRUE(says(scene, "2: 2 x PINHOLE 40x30"));
}

TEST_F(Transforms, ReadsPointsOrFindsSomeInThePhotographs) {
  Json json = line(5);
  write(json);
  options_.seed_points = true;
  const Scene found = load();
  EXPECT_GT(found.points.size(), 0);
  EXPECT_EQ(load().points.positions, found.points.positions);
  EXPECT_TRUE(says(found, "found in the photographs"));

  const PointCloud points{{0, 1, 2, 3, 4, 5}, {10, 20, 30, 40, 50, 60}};
  write_point_ply(folder_ / "sparse_pc.ply", points);
  json["ply_file_path"] = "sparse_pc.ply";
  json["applied_transform"] = {{0, 1, 0, 0}, {1, 0, 0, 0}, {0, 0, -1, 0}};
  write(json);
  const Scene scene = load();
  EXPECT_EQ(scene.points.positions, points.positions);
  EXPECT_EQ(scene.points.colors, points.colors);
  EXPECT_NEAR(scene.train[3].camera.center()[0], 3, 1e-15);  // applied_transform is ignored
  EXPECT_TRUE(says(scene, "2: sparse_pc.ply"));
}

TEST_F(Transforms, FindsPhotographsOutsideTheSceneAndInReducedFolders) {
  Json json = line(2);
  const fs::path other = folder_ / "scene";
  fs::create_directories(other);
  json["frames"][0]["file_path"] = "../images/00.png";
  json["frames"][1]["file_path"] = (folder_ / "images/01.png").string();
  write_bytes(other / "transforms.json", json.dump());
  options_.source_path = other.string();
  Scene scene = load();
  ASSERT_EQ(scene.train.size(), 2u);
  EXPECT_EQ(scene.warnings.size(), 0u);
  for (const View& view : scene.train) EXPECT_TRUE(fs::path(view.name).is_relative()) << view.name;

  options_.source_path = folder_.path().string();
  write(line(2));
  write_image(folder_ / "images_2/00.png", flat(kWidth / 2, kHeight / 2, 3, 77));
  write_image(folder_ / "images_2/01.png", flat(kWidth / 2, kHeight / 2, 3, 78));
  options_.images = "images_2";
  scene = load();
  EXPECT_EQ(scene.train[1].image->read()->pixels[0], 78);
  EXPECT_EQ(scene.train[1].camera.fx, 25);
}

TEST_F(Transforms, IntrinsicsInPixelsAreThoseOfThePhotographThatIsNamed) {
  Json json = line(2);
  json.erase("w");
  json.erase("h");
  write(json);
  const auto reduced = [&](const fs::path& folder, const char* extension = ".png") {
    for (const char* name : {"00", "01"}) {
      write_image(folder_ / folder / (name + std::string(extension)), flat(kWidth / 2, kHeight / 2, 3, 77));
    }
  };
  const auto expect_half = [&](const std::string& folder) {
    options_.images = folder;
    const Scene scene = load();
    ASSERT_EQ(scene.train.size(), 2u) << folder;
    const Camera& camera = scene.train[1].camera;
    EXPECT_EQ(scene.train[1].image->read()->pixels[0], 77);
    EXPECT_EQ(camera.width, kWidth / 2);
    EXPECT_EQ(camera.fx, 25) << folder;
    EXPECT_EQ(camera.fy, 30) << folder;
    EXPECT_EQ(camera.cx, 10.5) << folder;
    EXPECT_EQ(camera.cy, 7) << folder;
  };
  reduced("images_2");
  reduced("small");
  reduced("other", ".jpg");
  for (const char* folder : {"images_2", "small", "other"}) expect_half(folder);

  // The photograph is named without its extension, in a folder of another name.
  fs::rename(folder_ / "images", folder_ / "rgb");
  for (const char* name : {"00", "01"})
    fs::rename(folder_ / "rgb" / (name + std::string(".png")), folder_ / "rgb" / (name + std::string(".PNG")));
  json["frames"][0]["file_path"] = "rgb/00";
  json["frames"][1]["file_path"] = "rgb/01";
  write(json);
  expect_half("small");

  // Without the original photographs, the principal point shows by how much they were reduced.
  remove_tree(folder_ / "rgb");
  expect_half("images_2");
  json.erase("cx");
  json.erase("cy");
  write(json);
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json: frame 0 (rgb/00): expected w and h", "20 x 15 px; add w and h"}));
  json.erase("fl_x");
  json.erase("fl_y");
  json["camera_angle_x"] = 2 * std::atan(0.5);
  write(json);
  EXPECT_NEAR(load().train[1].camera.fx, kWidth / 2, 1e-9) << "an angle is the same at any size";
}

TEST_F(Transforms, RefusesReducedPhotographsOfAnUnknownSize) {
  Json json = line(1);
  json.erase("w");
  json.erase("h");
  remove_tree(folder_ / "images");
  write_image(folder_ / "small/00.png", flat(64, 48, 3, 77));
  options_.images = "small";
  for (const auto& [cx, cy] : {std::pair{109.0, 82.0}, {96.0, 82.0}, {109.0, 72.0}}) {  // 96 and 72: a third
    json["cx"] = cx;
    json["cy"] = cy;
    EXPECT_TRUE(refuses(json, {"transforms.json: frame 0 (./images/00.png): expected w and h", "64 x 48 px"})) << cx;
  }
  json["cx"] = 98.5;  // not quite in the centre
  write(json);
  EXPECT_NEAR(load().train[0].camera.fx, 50.0 / 3, 1e-9);
}

TEST_F(Transforms, PhotographsAreTurnedIfTheCameraIsUpright) {
  const std::vector<std::uint8_t> jpeg = test::jpeg_with_orientation(kWidth, kHeight, 6, false);
  Json json{{"fl_x", 50.0}, {"fl_y", 60.0}, {"cx", 14.0}, {"cy", 21.0}, {"w", kHeight}, {"h", kWidth}};
  json["frames"] = {frame(0, "images/a.jpg")};
  write_bytes(folder_ / "images/a.jpg", std::string(jpeg.begin(), jpeg.end()));
  for (const char* what : {"with a size", "with a principal point"}) {
    write(json);
    const Scene scene = load();
    const Camera& camera = scene.train[0].camera;
    EXPECT_EQ(camera.width, kHeight) << what;
    EXPECT_EQ(camera.height, kWidth) << what;
    EXPECT_EQ(camera.fx, 50) << what;
    EXPECT_EQ(camera.cy, 21) << what;
    EXPECT_EQ(scene.train[0].image->read()->size(), (ImageSize{kHeight, kWidth})) << what;
    EXPECT_TRUE(says(scene, "turned as their EXIF orientation says")) << what;
    json.erase("w");
    json.erase("h");
  }
}

TEST_F(Transforms, PathsMayHaveAnotherUnicodeForm) {
  const std::string decomposed = "Bu\xcc\x88ro", composed = "B\xc3\xbcro";
  Json json = line(1);
  json["frames"][0]["file_path"] = "rgb/" + decomposed + ".png";
  json["frames"][0]["mask_path"] = decomposed + "/m.png";
  json["ply_file_path"] = decomposed + ".ply";
  write(json);
  write_photograph("rgb/" + composed + ".png", 7);
  Image8 mask = flat(kWidth, kHeight, 1, 255);
  mask.pixels[0] = 0;
  write_image(folder_ / composed / "m.png", mask);
  write_point_ply(folder_ / (composed + ".ply"), {{0, 1, 2}, {10, 20, 30}});
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].image->read()->pixels[0], 17);
  EXPECT_NE(scene.train[0].valid, nullptr);
  EXPECT_EQ(scene.points.size(), 1);
}

TEST_F(Transforms, PathsMayHaveTheSeparatorsOfWindows) {
  Json json = line(3);
  const fs::path scene = folder_ / "scene";
  fs::create_directories(scene);
  write_image(scene / "masks of it/00.png", flat(kWidth, kHeight, 1, 0));
  *std::prev(json["frames"].end()) = frame(2, "C:\\Users\\me\\images\\02.png");  // found by its name
  fs::create_directories(scene / "images");
  fs::rename(folder_ / "images/02.png", scene / "images/02.png");
  fs::rename(folder_ / "images", folder_ / "rgb");
  json["frames"][0]["file_path"] = ".\\..\\rgb\\00.png";
  json["frames"][1]["file_path"] = "..\\rgb/01";
  json["frames"][0]["mask_path"] = ".\\masks of it\\00.png";
  json["ply_file_path"] = "pc\\points.ply";
  json["test_filenames"] = {"..\\rgb\\01"};
  write_point_ply(scene / "pc/points.ply", {{0, 1, 2}, {10, 20, 30}});
  write_bytes(scene / "transforms.json", json.dump());
  options_.source_path = scene.string();
  options_.eval = true;
  const Scene found = load();
  ASSERT_EQ(found.train.size(), 1u) << "the first photograph is masked out";
  EXPECT_EQ(found.train[0].image->read()->pixels[0], 12);
  ASSERT_EQ(found.test.size(), 1u);
  EXPECT_EQ(found.test[0].image->read()->pixels[0], 11);
  EXPECT_EQ(found.points.size(), 1);
  ASSERT_EQ(found.warnings.size(), 1u);
  EXPECT_NE(found.warnings[0].find("masks leave no pixel of 1 of 3"), std::string::npos) << found.warnings[0];
  json["ply_file_path"] = "..\\..\\private.ply";
  write_bytes(scene / "transforms.json", json.dump());
  EXPECT_TRUE(SceneFolder::refuses({"ply_file_path", "expected a file in the scene folder"}));
}

TEST_F(Transforms, PathsLeadNoFurtherThanTheFolderThatTheSceneIsIn) {
  Json json = line(2);
  const fs::path scene = folder_ / "all/scene";
  fs::create_directories(scene);
  fs::copy(folder_ / "images", scene / "images");
  write_photograph("private.png", 7);
  write_point_ply(folder_ / "private.ply", {{0, 1, 2}, {10, 20, 30}});
  options_.source_path = scene.string();
  const auto refuses_path = [&](const Json& changed, std::initializer_list<std::string> parts) {
    write_bytes(scene / "transforms.json", changed.dump());
    return fails_with<InputError>(parts, [&] { load(); });
  };
  const auto with = [&](const char* key, const std::string& path) {
    Json changed = json;
    changed["frames"][1][key] = path;
    return changed;
  };
  const std::string found = "expected a file in the scene folder or the folder that it is in, found ";
  for (const std::string& path : {std::string("../../private.png"), (folder_ / "private.png").string(),
                                  std::string("images/../../../private"), std::string("../../all/../private.png")}) {
    EXPECT_TRUE(refuses_path(with("file_path", path), {"file_path", "private.png", found, "link it there"})) << path;
  }
  for (const char* path : {"../../gone.png", "/gone/09.jpg"}) {  // missing, regardless of its location
    write_bytes(scene / "transforms.json", with("file_path", path).dump());
    EXPECT_EQ(load().train.size(), json["frames"].size() - 1) << path;
  }
  EXPECT_TRUE(refuses_path(with("mask_path", "../../private.png"), {"mask_path", "01.png", found}));
  json["ply_file_path"] = "../../private.ply";
  EXPECT_TRUE(refuses_path(json, {"transforms.json: ply_file_path", found}));
  json.erase("ply_file_path");

  // A link made by the user is followed. The name alone may also be found in the image folder.
  fs::create_symlink(folder_ / "private.png", scene / "linked.png");
  write_bytes(scene / "transforms.json", with("file_path", "linked.png").dump());
  EXPECT_EQ(load().train.size(), 2u);
  write_bytes(scene / "transforms.json", with("file_path", "../../images/01.png").dump());
  EXPECT_EQ(load().train.size(), 2u);
  // The path is from another machine.
  fs::rename(scene / "images/01.png", scene / "images/02.png");
  write_bytes(scene / "transforms.json", with("file_path", "/gone/02.jpg").dump());
  EXPECT_EQ(load().train.size(), 2u);
  fs::rename(scene / "images/02.png", scene / "images/01.png");
  // The scene folder has another name.
  fs::create_directory_symlink(scene, folder_ / "link");
  options_.source_path = (folder_ / "link").string();
  fs::rename(scene / "images/01.png", scene / "other.png");
  write_bytes(scene / "transforms.json", with("file_path", (scene / "other.png").string()).dump());
  EXPECT_EQ(load().train.size(), 2u);
}

TEST_F(Transforms, LeavesOutMissingPhotographs) {
  Json json = line(3);
  json["frames"][1]["file_path"] = "images/gone";
  json.erase("w");
  write(json);
  const Scene scene = load();
  EXPECT_EQ(scene.train.size(), 2u);
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("1 of 3 registered images not found (first: images/gone.png)"), std::string::npos)
      << scene.warnings[0];
}

TEST_F(Transforms, LeavesOutFramesWithNumbersThatAreNotFinite) {
  Json json = line(4);
  json["frames"][1]["transform_matrix"][2][3] = "?1";
  json["frames"][2]["fl_x"] = "?2";
  json["totp"] = "?1";
  json["note"] = "NaN, \\\"Infinity";
  json["train_filenames"] = {"images/00.png", "images/01.png", "images/02.png", "images/03.png"};
  std::string text = json.dump(1);
  const auto replace_all = [&](const std::string& from, const std::string& to) {
    for (std::size_t at = 0; (at = text.find(from)) != std::string::npos;) text.replace(at, from.size(), to);
  };
  replace_all("\"?1\"", "NaN");
  replace_all("\"?2\"", "-Infinity");
  write_bytes(folder_ / "transforms.json", text);
  const Scene scene = load();
  ASSERT_EQ(scene.train.size(), 2u);
  EXPECT_EQ(scene.train[1].name, "images/03.png");
  ASSERT_EQ(scene.warnings.size(), 1u);
  for (const char* part : {"frame 1 (./images/01.png): expected transform_matrix to be finite, found NaN",
                           "leave out 2 of 4 images (first: images/01.png)"}) {
    EXPECT_NE(scene.warnings[0].find(part), std::string::npos) << scene.warnings[0];
  }
  replace_all("50.0", "Infinity");  // fl_x of the file
  write_bytes(folder_ / "transforms.json", text);
  EXPECT_TRUE(SceneFolder::refuses({"frame 0 (./images/00.png): expected fl_x to be finite, found Infinity"}));
}

TEST_F(Transforms, LeavesOutFramesWhoseMatrixIsNotAPose) {
  const Json zero(4, Json(4, 0)), mirror{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}, {0, 0, 0, 1}};
  for (const auto& [matrix, fault] : {std::pair{zero, "last row 0 0 0 1"}, {mirror, "mirrors"}}) {
    Json json = line(4);
    json["frames"][1]["transform_matrix"] = matrix;
    write(json);
    const Scene scene = load();
    EXPECT_EQ(scene.train.size(), 3u);
    ASSERT_EQ(scene.warnings.size(), 1u);
    for (const char* part : {"frame 1 (./images/01.png): transform_matrix: expected", fault,
                             "leave out 1 of 4 images (first: images/01.png)"}) {
      EXPECT_NE(scene.warnings[0].find(part), std::string::npos) << scene.warnings[0];
    }
    for (Json& frame : json["frames"]) frame["transform_matrix"] = matrix;
    EXPECT_TRUE(refuses(json, {"frame 0 (./images/00.png): transform_matrix: expected", fault})) << "all of them";
  }
}

TEST_F(Transforms, RefusesHalfACharacterInAString) {
  for (const char* half : {"\\ud800", "\\udc00", "\\ud800\\ud800", "\\ud800x"}) {
    for (const char* key : {"file_path", "camera_model", "x"}) {
      std::string text = line(2).dump();
      text.insert(text.find("\"file_path\""), std::string("\"") + key + "\": \"" + half + "\", ");
      write_bytes(folder_ / "transforms.json", text);
      EXPECT_TRUE(SceneFolder::refuses({"transforms.json: not valid JSON: parse error", "surrogate"})) << half << key;
    }
  }
}

TEST_F(Transforms, ReadsNumbersThatAreNotFiniteBesideComments) {
  const std::string frames = line(2).dump();
  for (const char* number : {"NaN", "nan", "-nan", "inf", "-inf", "-Infinity"}) {
    for (const char* comment : {"// 5\" wide, nan\n", "/* 5\" wide,\n nan */", "/**/", ""}) {
      write_bytes(folder_ / "transforms.json",
                  detail::concat("{", comment, "\"unused\": ", number, ", \"url\": \"http://a/*\",", frames.substr(1)));
      EXPECT_EQ(load().train.size(), 2u) << number << comment;
    }
  }
  write_bytes(folder_ / "transforms.json", "{\"unused\": NaN, /* without an end");
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json: not valid JSON", "missing closing '*/'"}));
}

TEST_F(Transforms, AColmapModelComesFirst) {
  write(line(1));
  ColmapModel model;
  model.cameras[1] = {1, CameraModel::kPinhole, kWidth, kHeight, {99, 99, 20, 15}};
  model.images.push_back({1, {1, 0, 0, 0}, {0, 0, 0}, 1, "00.png"});
  write_colmap_model(folder_ / "sparse/0", model, ColmapFormat::kBinary);
  const Scene scene = load();
  EXPECT_EQ(scene.train[0].camera.fx, 99);
  EXPECT_TRUE(says(scene, "transforms.json is not used"));
}

TEST_F(Transforms, RefusesBadInputWithFileAndFrame) {
  const Json good = line(2);
  const auto changed = [&](const auto& change) {
    Json json = good;
    change(json["frames"][1]);
    return json;
  };
  const std::string place = "transforms.json: frame 1 (./images/01.png)";
  const auto with = [&](const char* key, const Json& value) { return changed([&](Json& f) { f[key] = value; }); };
  EXPECT_TRUE(refuses(with("transform_matrix", "no"), {place, "4 rows of 4 numbers", "\"no\""}));
  EXPECT_TRUE(refuses(with("transform_matrix", {{1, 0, 0, 0}, {0, 1, 0, 0}}), {place, "4 rows"}));
  EXPECT_TRUE(refuses(with("transform_matrix", {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}), {place, "4 rows"}));
  EXPECT_TRUE(refuses(with("transform_matrix", {{1, 0, 0, nullptr}, {0, 1, 0, 0}, {0, 0, 1, 0}}), {place, "null"}));
  EXPECT_TRUE(refuses(changed([](Json& f) { f.erase("transform_matrix"); }), {place, "found none"}));
  EXPECT_TRUE(refuses(changed([](Json& f) { f.erase("file_path"); }), {"frame 1", "file_path"}));
  EXPECT_TRUE(refuses(with("file_path", 7), {"frame 1", "file_path", "7"}));
  EXPECT_TRUE(refuses(with("file_path", ".."), {"frame 1", "file_path"}));
  EXPECT_TRUE(refuses(with("file_path", "images/\x1b[31m.png"), {"frame 1 (images/?[31m.png)", "control characters"}));
  EXPECT_TRUE(refuses(with("file_path", "images/00.png"), {"frame 1", "two frames"}));
  EXPECT_TRUE(refuses(with("fl_x", "50"), {place, "fl_x", "\"50\""}));
  EXPECT_TRUE(refuses(with("fl_x", 0), {place, "focal lengths above 0"}));
  EXPECT_TRUE(refuses(with("w", 40.5), {place, "w", "whole number", "40.5"}));
  EXPECT_TRUE(refuses(with("h", -1), {place, "h", "whole number"}));
  EXPECT_TRUE(refuses(with("w", 1e300), {place, "w"}));
  EXPECT_TRUE(refuses(with("k1", true), {place, "k1", "true"}));
  EXPECT_TRUE(refuses(with("k4", 0.5), {place, "k4", "FULL_OPENCV"}));
  EXPECT_TRUE(refuses(with("camera_model", "SPHERE"), {place, "SPHERE", "OPENCV_FISHEYE", "EQUIRECTANGULAR"}));
  EXPECT_TRUE(refuses(with("camera_model", "EQUIRECTANGULAR"), {place, "panorama", "twice as wide as high"}));
  EXPECT_TRUE(refuses(with("camera_model", 3), {place, "camera_model", "3"}));
  EXPECT_TRUE(refuses(with("mask_path", 3), {place, "mask_path"}));
  Json none = good;
  none["frames"] = Json::array();
  EXPECT_TRUE(refuses(none, {"transforms.json", "frames"}));
  EXPECT_TRUE(refuses(Json::array(), {"transforms.json", "expected a JSON object"}));
  Json blind = good;
  blind.erase("fl_x");
  blind.erase("fl_y");
  EXPECT_TRUE(refuses(blind, {"frame 0", "fl_x", "camera_angle_x"}));
  blind["camera_angle_x"] = 4;
  EXPECT_TRUE(refuses(blind, {"frame 0", "camera_angle_x", "pi"}));
  Json points = good;
  points["ply_file_path"] = "gone.ply";
  EXPECT_TRUE(refuses(points, {"transforms.json: ply_file_path: file not found", "gone.ply; correct the path"}));
  const Json gone = with("mask_path", "gone.png");
  EXPECT_TRUE(
      refuses(gone, {"transforms.json: mask_path of the photograph images/01.png: file not found", "gone.png"}));
  options_.masks = "none";
  EXPECT_EQ(load().train.size(), 2u);
  const std::string text = good.dump();
  write_bytes(folder_ / "transforms.json", text.substr(0, text.size() / 2));
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json: not valid JSON: parse error at line 1, column "}));
  write_bytes(folder_ / "transforms.json", "{\n \"frames\": [NoN]}");
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json", "line 2, column 13", "[N'"}));
  write_bytes(folder_ / "transforms.json", "{\n \"frames\": [NaN]}");
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json: frame 0: expected an object, found \"NaN\""}));
  write_bytes(folder_ / "transforms.json", std::string(99, '['));
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json", "not valid JSON"}));
  write_bytes(folder_ / "transforms.json", std::string(99, '[') + std::string(99, ']'));
  EXPECT_TRUE(SceneFolder::refuses({"transforms.json", "nesting of more than 64 levels"}));
}

}  // namespace
}  // namespace b3dgs
