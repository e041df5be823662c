// Photographs with names that are not UTF-8, in the files of a model folder.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "core/files/atomic_file.h"
#include "model/cameras/cameras_json.h"
#include "model/model_folder.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns two views with names that differ in one byte, which is not UTF-8.
Scene scene_of_latin_1(const fs::path& folder) {
  Scene scene;
  for (const std::string name : {"caf\xe9.png", "caf\xe8.png"}) {
    View view;
    view.name = name;
    view.file = (folder / name).string();
    view.camera = Camera::with_field_of_view(64, 48, 60, {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 4}});
    test::write_bytes(view.file, name);
    scene.train.push_back(view);
  }
  return scene;
}

TEST(NamesThatAreNotUtf8, StayAsTheyAreInCamerasAndPoses) {
  const test::TempDir temp;
  const ModelFolder folder(temp / "model");
  create_folder(folder.root());
  const Scene scene = scene_of_latin_1(temp.path());
  std::vector<View> refined = scene.train;
  refined[0].camera.cam_from_world.translation = {1, 2, 5};
  refined[1].camera.cam_from_world.translation = {3, 4, 6};
  folder.write_poses(scene, refined);
  const std::vector<NamedCamera> cameras = read_cameras_json(folder.cameras());
  ASSERT_EQ(cameras.size(), 2u);
  std::vector<View> views = scene.train;
  apply_refined_poses(folder.poses(), views);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(cameras[i].name, scene.train[i].name);
    EXPECT_EQ(views[i].camera.cam_from_world.translation, refined[i].camera.cam_from_world.translation);
  }
}

TEST(NamesThatAreNotUtf8, TellChangedPhotographsApart) {
  const test::TempDir temp;
  const ModelFolder folder(temp / "model");
  create_folder(folder.root());
  const Scene scene = scene_of_latin_1(temp.path());
  TrainConfig config;
  config.source_path = (temp / "sc\xe8ne").string();
  folder.write_inputs(config, scene);
  EXPECT_EQ(folder.read_config().source_path, config.source_path);
  EXPECT_TRUE(changed_views(folder.photographs(), scene.train).empty());
  test::write_bytes(scene.train[1].file, "changed");
  EXPECT_EQ(changed_views(folder.photographs(), scene.train), std::vector<std::string>{"caf\xe8.png"});
}

TEST(NamesThatAreNotUtf8, HaveResultsOfTheirOwn) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  folder.write_results("ours_1", {{{"caf\xe9.png", {20, 0.5}}, {"caf\xe8.png", {30, 0.75}}}, {25, 0.625}}, {});
  const auto per_view = nlohmann::json::parse(test::read_bytes(temp / "per_view.json"))["ours_1"]["PSNR"];
  EXPECT_EQ(per_view, (nlohmann::json{{"caf\x1a"
                                       "e9.png",
                                       20},
                                      {"caf\x1a"
                                       "e8.png",
                                       30}}));
}

}  // namespace
}  // namespace b3dgs
