// scripts/disturb_scene.py: what it changes, what it leaves alone, and bad input.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "data_synth/synth_writer.h"
#include "scene/scene.h"
#include "scene/view_image.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

class DisturbScene : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override {
    if (run("python3 -c 'import numpy, PIL'") != 0) GTEST_SKIP() << "python3 with numpy and Pillow is missing";
    SynthConfig config;
    config.scene = "orbit";
    config.output = source_.string();
    config.format = GetParam();
    config.points = 300;
    config.views = 10;
    config.width = 48;
    config.height = 32;
    write_synth_scene(config, make_scene(config));
  }

  int run(const std::string& command) {
    const int status = std::system((command + " > '" + (folder_ / "out").string() + "' 2>&1").c_str());
    return WEXITSTATUS(status);
  }
  int disturb(const std::string& options) {
    return run(B3DGS_SOURCE "/scripts/disturb_scene.py '" + source_.string() + "' '" + output_.string() + "' " +
               options);
  }
  std::string words() { return test::read_bytes(folder_ / "out"); }

  Scene load(const fs::path& folder) {
    SceneOptions options;
    options.source_path = folder.string();
    options.eval = true;
    options.frame = CoordinateFrame{};
    return load_scene(options);
  }

  /// Expects exit code 2, `text` in one line, and no output.
  void expect_refused(const std::string& options, const std::string& text) {
    EXPECT_EQ(disturb(options), 2) << words();
    EXPECT_NE(words().find(text), std::string::npos) << words();
    EXPECT_EQ(words().find("Traceback"), std::string::npos) << words();
    for (const fs::directory_entry& entry : fs::directory_iterator(folder_.path())) {
      EXPECT_NE(entry.path().filename().string().rfind("output", 0), 0u) << entry.path();
    }
  }

  fs::path model_file() { return source_ / "sparse/0" / (GetParam() == "binary" ? "images.bin" : "images.txt"); }

  test::TempDir folder_;
  fs::path source_ = folder_ / "source", output_ = folder_ / "output";
};

TEST_P(DisturbScene, ChangesPixelsOfTrainingPhotographsOnly) {
  ASSERT_EQ(disturb("--gains 0.3 --cover"), 0) << words();
  const Scene before = load(source_), after = load(output_);
  ASSERT_EQ(after.train.size(), 8u);
  for (const View& view : after.test) {
    EXPECT_EQ(test::read_bytes(view.file), test::read_bytes(source_ / "images" / view.name));
    EXPECT_EQ(view.mask_file, "");
  }
  for (std::size_t i = 0; i < after.train.size(); ++i) {
    EXPECT_NE(after.train[i].image->read(), before.train[i].image->read());
    EXPECT_EQ(after.train[i].camera.cam_from_world.translation, before.train[i].camera.cam_from_world.translation);
    ASSERT_NE(after.train[i].mask_file, "");
  }
}

TEST_P(DisturbScene, TurnsAndMovesTrainingCamerasByWhatWasAskedFor) {
  ASSERT_EQ(disturb("--turn 0.5 --move 0.01"), 0) << words();
  const Scene before = load(source_), after = load(output_);
  for (std::size_t i = 0; i < after.test.size(); ++i) {
    EXPECT_EQ(after.test[i].camera.cam_from_world.rotation, before.test[i].camera.cam_from_world.rotation);
    EXPECT_EQ(after.test[i].camera.cam_from_world.translation, before.test[i].camera.cam_from_world.translation);
  }
  for (std::size_t i = 0; i < after.train.size(); ++i) {
    const Camera &a = before.train[i].camera, &b = after.train[i].camera;
    double trace = 0, moved = 0;
    for (int k = 0; k < 9; ++k) trace += a.cam_from_world.rotation[k] * b.cam_from_world.rotation[k];
    for (int k = 0; k < 3; ++k) moved += std::pow(a.center()[k] - b.center()[k], 2);
    EXPECT_NEAR(std::acos((trace - 1) / 2) * 180 / M_PI, 0.5, 1e-5);
    EXPECT_NEAR(std::sqrt(moved), 0.01 * before.extent, 1e-9);
    EXPECT_EQ(test::read_bytes(after.train[i].file), test::read_bytes(before.train[i].file));
  }
}

TEST_P(DisturbScene, RefusesBadInput) {
  expect_refused("", "no fault to make");
  expect_refused("--gains nan", "--gains");
  expect_refused("--turn 0.3 --seed -1", "--seed: expected 0 or more");
  const std::string model = test::read_bytes(model_file());
  if (GetParam() == "binary") {
    test::write_bytes(model_file(), model.substr(0, model.size() - 5));
    expect_refused("--turn 0.3", "ends in image 10");
    test::write_bytes(model_file(), std::string(8, '\xff') + model.substr(8));
    expect_refused("--turn 0.3", "ends in image 11");
  } else {
    test::write_bytes(model_file(), "1 0 0 0 1\n\n");
    expect_refused("--turn 0.3", "images.txt:1: expected ID QW");
    test::write_bytes(model_file(), "1 nan 0 0 1 0 0 0 1 00001.png\n\n");
    expect_refused("--turn 0.3", "not finite");
  }
  test::write_bytes(model_file(), model);
  test::write_bytes(source_ / "images/00003.png", "\x89PNG");
  expect_refused("--gains 0.3", "00003.png");
  fs::create_directories(source_ / "masks");
  expect_refused("--cover", "has masks already");
  fs::remove(model_file());
  expect_refused("--turn 0.3", "no images.bin or images.txt");
  test::write_bytes(output_, "mine");
  EXPECT_EQ(disturb("--turn 0.3"), 2);
  EXPECT_EQ(test::read_bytes(output_), "mine");
}

INSTANTIATE_TEST_SUITE_P(Formats, DisturbScene, testing::Values("binary", "text"),
                         [](const auto& instance) { return instance.param; });

}  // namespace
}  // namespace b3dgs
