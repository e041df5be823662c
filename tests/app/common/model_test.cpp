// Loading of trained models for eval and render: device, scene and resolution options, cameras without photographs.
#include "app/common/torch/model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"
#include "train/evaluate.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;

LoadedModel load_model(const ModelOptions& options, StatusLine& status) {
  LoadedModel model = load_model(options);
  add_scene(model, status);
  return model;
}

LoadedModel load_cameras(const ModelOptions& options, StatusLine& status) {
  LoadedModel model = load_model(options);
  add_cameras(model, options, status);
  return model;
}

class TrainedModel : public ::testing::Test {
 protected:
  TrainedModel() {
    make_scene("scene", "1");
    const Outcome trained = run_b3dgs({"train", path("scene"), "-m", path("model"), "--eval", "--iterations", "3",
                                       "--test_iterations", "3", "--device", "cpu", "--quiet"});
    EXPECT_EQ(trained.exit_code, 0) << trained.err;
    options_.model_path = path("model");
    options_.device = "cpu";
  }
  void make_scene(const std::string& name, const std::string& seed) const {
    const Outcome made = run_b3dgs({"synth", "orbit", path(name), "--points", "300", "--views", "9", "--width", "64",
                                    "--height", "48", "--seed", seed, "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  nlohmann::json results() const { return nlohmann::json::parse(read_bytes(folder_ / "model/results.json")); }
  void change_config(const std::string& key, const nlohmann::ordered_json& value) const {
    const fs::path file = folder_ / "model/config.json";
    auto config = nlohmann::ordered_json::parse(read_bytes(file));
    config[key] = value;
    write_file(file, config.dump());
  }

  test::TempDir folder_;
  ModelOptions options_;
  std::ostringstream messages_;
  StatusLine status_{messages_, 0, /*quiet=*/true};
};

TEST_F(TrainedModel, OfAFolderThatCannotBeWrittenTheResultsArePrinted) {
  test::RunOptions as_user;
  as_user.obeys_permissions = true;
  const auto evaluate = [&](std::vector<std::string> more) {
    std::vector<std::string> words{"eval", path("model"), "--device", "cpu"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words, as_user);
  };
  const auto listed = [&] {
    std::set<std::string> names;
    for (const auto& entry : fs::recursive_directory_iterator(path("model"))) names.insert(entry.path().string());
    return names;
  };
  fs::remove(path("model/results.json"));
  const std::set<std::string> before = listed();
  const auto expect_printed_only = [&](const Outcome& outcome, const std::string& file) {
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("mean of"), std::string::npos) << outcome.out;
    EXPECT_EQ(outcome.out.find("written:"), std::string::npos) << outcome.out;
    EXPECT_NE(outcome.err.find("results are printed only: cannot write " + path("model/" + file)), std::string::npos)
        << outcome.err;
  };
  fs::permissions(path("model"), fs::perms::owner_read | fs::perms::owner_exec);
  expect_printed_only(evaluate({}), "results.json");
  expect_printed_only(evaluate({"--split", "all"}), "results.json");
  const Outcome images = evaluate({"--split", "train", "--save_images"});
  EXPECT_EQ(images.exit_code, 2);
  EXPECT_EQ(images.out, "") << "refused before anything is rendered";
  EXPECT_EQ(images.err.rfind("error: cannot write " + path("model/train/views.json") + " (expected a ", 0), 0u)
      << images.err;
  EXPECT_NE(images.err.find("; allow writing there, or evaluate a copy of the model folder\n"), std::string::npos)
      << images.err;
  const Outcome prints_only = evaluate({"--split", "train", "--quiet"});
  EXPECT_EQ(prints_only.exit_code, 0) << prints_only.err;
  EXPECT_EQ(prints_only.err, "") << "writes nothing, so needs no permission";
  fs::permissions(path("model"), fs::perms::owner_all);
  EXPECT_EQ(listed(), before);

  fs::remove(path("model/per_view.json"));
  fs::create_directory(path("model/per_view.json"));
  expect_printed_only(evaluate({}), "per_view.json");
  remove_tree(path("model/per_view.json"));
  const Outcome writable = evaluate({"--save_images", "--quiet"});
  EXPECT_EQ(writable.exit_code, 0) << writable.err;
  EXPECT_TRUE(results().contains("ours_3"));
}

TEST_F(TrainedModel, OfUnreadableResultsTheNewOnesArePrinted) {
  for (const char* name : {"results.json", "per_view.json"}) {
    write_file(path(std::string("model/") + name), R"({"a": 1, "a": 2})");
    const Outcome outcome = run_b3dgs({"eval", path("model"), "--device", "cpu"});
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("mean of"), std::string::npos) << outcome.out;
    EXPECT_NE(outcome.err.find("results are printed only: " + path(std::string("model/") + name) +
                               ": expected each key once"),
              std::string::npos)
        << outcome.err;
    const Outcome images = run_b3dgs({"eval", path("model"), "--device", "cpu", "--save_images"});
    EXPECT_EQ(images.exit_code, 2);
    EXPECT_EQ(images.out, "") << "refused before anything is rendered";
    fs::remove(path(std::string("model/") + name));
  }
}

TEST_F(TrainedModel, OfASceneThatHasMovedNamesTheOption) {
  fs::rename(path("scene"), path("moved"));
  const Outcome outcome = run_b3dgs({"eval", path("model"), "--device", "cpu"});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("scene folder not found: " + path("scene") + "; if the scene of " + path("model") +
                             " has moved, name its folder with -s\n"),
            std::string::npos)
      << outcome.err;
  EXPECT_EQ(run_b3dgs({"eval", path("model"), "-s", path("moved"), "--device", "cpu", "--quiet"}).exit_code, 0);
}

TEST_F(TrainedModel, AFolderOfAnotherProgramSaysHowItsGaussiansAreUsed) {
  fs::remove(path("model/config.json"));
  const Outcome outcome = run_b3dgs({"eval", path("model"), "--device", "cpu"});
  EXPECT_EQ(outcome.exit_code, 2);
  const std::string ply = path("model/point_cloud/iteration_3/point_cloud.ply");
  EXPECT_NE(outcome.err.find(ply + " -s SCENE"), std::string::npos) << outcome.err;
  EXPECT_EQ(run_b3dgs({"eval", ply, "-s", path("scene"), "--device", "cpu", "--quiet"}).exit_code, 0);
  const Outcome info = run_b3dgs({"info", path("model")});
  EXPECT_EQ(info.exit_code, 0) << info.err;
  EXPECT_NE(info.out.find("Gaussians"), std::string::npos) << info.out;
}

TEST_F(TrainedModel, AFileOfGaussiansCanBeMeasuredOnOnePhotograph) {
  for (const auto& photograph : fs::directory_iterator(path("scene/images"))) {
    if (photograph.path().stem() != "00000") fs::remove(photograph);
  }
  const std::string ply = path("model/point_cloud/iteration_3/point_cloud.ply");
  const auto evaluate = [&](const std::string& split) {
    return run_b3dgs({"eval", ply, "-s", path("scene"), "--split", split, "--device", "cpu", "--quiet"});
  };
  for (const char* split : {"auto", "all", "test"}) {
    const Outcome outcome = evaluate(split);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("mean of 1 "), std::string::npos) << outcome.out;
  }
  const Outcome none = evaluate("train");
  EXPECT_EQ(none.exit_code, 2);
  EXPECT_NE(none.err.find("expected at least one view of --split train, found none of 1; evaluate all"),
            std::string::npos)
      << none.err;
}

TEST_F(TrainedModel, TheDeviceIsThatOfTheMachineThatRenders) {
  change_config("device", "cuda");
  const LoadedModel model = load_model(options_, status_);
  EXPECT_EQ(model.config.device, "cpu");
}

TEST_F(TrainedModel, IsRenderedAndEvaluatedWithRefinedPoses) {
  const auto position = [](const LoadedModel& model) { return model.scene.train.at(2).camera.center(); };
  const auto given = position(load_model(options_, status_));
  const Outcome trained =
      run_b3dgs({"train", path("scene"), "-m", path("model"), "--overwrite", "--eval", "--iterations", "9",
                 "--pose_opt", "--densify_from_iter", "0", "--device", "cpu", "--quiet"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  const auto poses = nlohmann::json::parse(read_bytes(folder_ / "model/poses.json"));
  ASSERT_GT(poses.at(2).at("moved").get<double>(), 0.0005);
  const auto refined = position(load_cameras(options_, status_));  // from cameras.json
  EXPECT_GT(std::hypot(refined[0] - given[0], refined[1] - given[1], refined[2] - given[2]), 0.0005);
  fs::rename(folder_ / "scene", folder_ / "moved");
  options_.source_path = path("moved");
  options_.resolution = 2;
  for (const LoadedModel& model : {load_model(options_, status_), load_cameras(options_, status_)}) {
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(position(model)[axis], refined[axis], 1e-9);
    EXPECT_EQ(results_variant(model, options_), "r2");
  }
  make_scene("other", "2");  // with the same photograph names, but other poses
  options_.source_path = path("other");
  const auto of_other = position(load_model(options_, status_));
  fs::remove(folder_ / "model/poses.json");
  EXPECT_EQ(of_other, position(load_model(options_, status_)));
}

TEST_F(TrainedModel, ImagesKeepNothingForABackwardPass) {
  change_config("deterministic", true);
  change_config("kernel", "naive");
  const LoadedModel model = load_cameras(options_, status_);
  EXPECT_FALSE(image_settings(model).keep_for_backward) << "on a GPU this pair has no backward pass";
  EXPECT_EQ(run_b3dgs({"render", path("model"), "--device", "cpu", "--quiet"}).exit_code, 0);
}

TEST_F(TrainedModel, EvaluationWarnsOfPhotographsThatHaveChanged) {
  const auto evaluate = [&](std::vector<std::string> more) {
    std::vector<std::string> words{"eval", path("model"), "--device", "cpu", "--quiet"};
    words.insert(words.end(), more.begin(), more.end());
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    return outcome.err;
  };
  EXPECT_EQ(evaluate({}), "");
  const fs::path test_view = folder_ / "scene/images/00008.png";
  Image8 image = read_image(test_view, false);
  image.pixels[0] ^= 1;
  write_image(test_view, image);
  const std::string warning = "warning: 1 of 2 photographs have changed since training (00008.png); ";
  EXPECT_EQ(evaluate({}).rfind(warning, 0), 0u) << evaluate({});
  EXPECT_EQ(evaluate({"-r", "2"}).rfind(warning, 0), 0u);
  EXPECT_EQ(evaluate({"--split", "train"}), "") << "the training views are unchanged";
  make_scene("other", "2");
  EXPECT_EQ(evaluate({"-s", path("other")}).find("have changed"), std::string::npos) << "other views, not changed ones";
  fs::remove(folder_ / "model/photographs.json");
  EXPECT_EQ(evaluate({}), "") << "a model of an early version";
}

TEST_F(TrainedModel, TestViewsAreThoseThatTheTrainingHeldOut) {
  const auto names = [&] {
    std::vector<std::string> test;
    for (const View& view : load_model(options_, status_).scene.test) test.push_back(view.name);
    return test;
  };
  using Names = std::vector<std::string>;
  ASSERT_EQ(names(), (Names{"00000.png", "00008.png"}));
  const fs::path images = folder_ / "scene/images";
  fs::rename(images / "00003.png", folder_ / "aside.png");  // every 8th of the remaining ones: only 00000
  EXPECT_EQ(names(), (Names{"00000.png", "00008.png"}));
  EXPECT_NE(messages_.str().find("not found, but used by the training: 1 view (00003.png)"), std::string::npos)
      << messages_.str();
  fs::rename(images / "00000.png", images / "00003.png");
  EXPECT_EQ(names(), Names{"00008.png"});

  fs::rename(images / "00003.png", images / "00000.png");
  ASSERT_EQ(run_b3dgs({"train", path("scene"), "-m", path("model"), "--overwrite", "--eval", "--iterations", "3",
                       "--device", "cpu", "--quiet"})
                .exit_code,
            0);
  fs::rename(folder_ / "aside.png", images / "00003.png");  // restored, but neither trained on nor held out
  EXPECT_EQ(names(), Names{"00000.png"});
  EXPECT_NE(messages_.str().find("left out, since the training did not have them: 1 view (00003.png)"),
            std::string::npos)
      << messages_.str();
}

TEST_F(TrainedModel, RendersTheSameWithoutTheScene) {
  const LoadedModel with_scene = load_model(options_, status_);
  const Outcome before = run_b3dgs({"render", path("model"), "-s", path("scene"), "--output", path("before")});
  ASSERT_EQ(before.exit_code, 0) << before.err;
  remove_tree(path("scene"));
  const LoadedModel model = load_cameras(options_, status_);
  ASSERT_EQ(model.scene.test.size(), with_scene.scene.test.size());
  ASSERT_EQ(model.scene.train.size(), with_scene.scene.train.size());
  for (std::size_t i = 0; i < model.scene.train.size(); ++i) {
    EXPECT_EQ(model.scene.train[i].name, with_scene.scene.train[i].name);
  }
  const Outcome after = run_b3dgs({"render", path("model"), "--output", path("after")});
  ASSERT_EQ(after.exit_code, 0) << after.err;
  const Image8 expected = read_image(folder_ / "before/renders/00001.png", false);
  const Image8 found = read_image(folder_ / "after/renders/00001.png", false);
  ASSERT_EQ(found.pixels.size(), expected.pixels.size());
  int largest = 0;
  for (std::size_t i = 0; i < found.pixels.size(); ++i) {
    largest = std::max(largest, std::abs(int{found.pixels[i]} - int{expected.pixels[i]}));
  }
  EXPECT_LE(largest, 1);
}

TEST_F(TrainedModel, APlyInAModelFolderIsRenderedWithItsCameras) {
  remove_tree(path("scene"));
  const Outcome rendered = run_b3dgs({"render", path("model/point_cloud/iteration_3/point_cloud.ply")});
  ASSERT_EQ(rendered.exit_code, 0) << rendered.err;
  EXPECT_TRUE(fs::exists(folder_ / "model/test/ours_3/renders/00001.png"));
  fs::copy(folder_ / "model/point_cloud/iteration_3/point_cloud.ply", folder_ / "alone.ply");
  const Outcome alone = run_b3dgs({"render", path("alone.ply")});
  EXPECT_EQ(alone.exit_code, 2);
  EXPECT_NE(alone.err.find("alone.ply; name a scene with -s"), std::string::npos) << alone.err;
}

TEST_F(TrainedModel, ResultsOfAnotherSizeOrSceneStandBesideItsOwn) {
  const nlohmann::json own = results()["ours_3"];
  EXPECT_EQ(own["width"], 64);
  EXPECT_EQ(own["resolution"], -1);
  EXPECT_EQ(own["source_path"], path("scene"));
  EXPECT_EQ(own["split"], "test");

  ASSERT_EQ(run_b3dgs({"eval", path("model"), "-r", "2", "--save_images"}).exit_code, 0);
  make_scene("other", "2");
  ASSERT_EQ(run_b3dgs({"eval", path("model"), "-s", path("other")}).exit_code, 0);
  nlohmann::json found = results();
  EXPECT_EQ(found["ours_3"], own);
  EXPECT_EQ(found["ours_3_r2"]["width"], 32);
  EXPECT_TRUE(fs::exists(folder_ / "model/test/ours_3_r2/renders/00000.png"));
  EXPECT_EQ(found["ours_3_other"]["source_path"], path("other"));
  EXPECT_EQ(found.size(), 3u);
  ASSERT_EQ(run_b3dgs({"render", path("model"), "-s", path("other"), "--quiet"}).exit_code, 0);
  EXPECT_TRUE(fs::exists(folder_ / "model/test/ours_3_other/renders/00000.png"));
  EXPECT_FALSE(fs::exists(folder_ / "model/test/ours_3"));

  fs::rename(folder_ / "scene", folder_ / "moved");
  ASSERT_EQ(run_b3dgs({"eval", path("model"), "-s", path("moved")}).exit_code, 0);
  found = results();
  EXPECT_EQ(found.size(), 3u) << "the same scene in another folder";
  EXPECT_EQ(found["ours_3"]["source_path"], path("moved"));
  EXPECT_NEAR(found["ours_3"]["PSNR"].get<double>(), own["PSNR"].get<double>(), 1e-3);
}

TEST_F(TrainedModel, OfAWideLensIsEvaluatedInItAndOnRequestUndistorted) {
  ASSERT_EQ(run_b3dgs({"synth", "orbit", path("wide"), "--points", "300", "--views", "9", "--width", "64", "--height",
                       "64", "--lens", "OPENCV_FISHEYE", "--fov", "190", "--quiet"})
                .exit_code,
            0);
  ASSERT_EQ(run_b3dgs({"train", path("wide"), "-m", path("model"), "--overwrite", "--eval", "--iterations", "3",
                       "--test_iterations", "3", "--device", "cpu", "--quiet"})
                .exit_code,
            0);
  EXPECT_NE(read_bytes(folder_ / "model/cameras.json").find("FISHEYE"), std::string::npos) << "auto keeps it";
  const nlohmann::json own = results();
  ASSERT_EQ(own.size(), 1u);
  ASSERT_EQ(run_b3dgs({"eval", path("model"), "--lenses", "undistort"}).exit_code, 0);
  const nlohmann::json found = results();
  ASSERT_EQ(found.size(), 2u);
  for (const auto& [key, value] : found.items()) {
    EXPECT_EQ(key.find("undistort") != std::string::npos, !own.contains(key)) << key;
  }
  EXPECT_EQ(found.at(own.begin().key()), own.begin().value());
}

}  // namespace
}  // namespace b3dgs
