// Tests failures to write the last files of a training, and those that a viewer's Save or a signal requests.
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "support/full_disk.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::eventful_config;
using test::FileSizeLimit;
using test::train;
using test::Trained;

class TrainerFiles : public testing::Test {
 protected:
  /// Returns the error of a training that cannot write its last files, or "" if it does not fail.
  std::string error_of(const TrainConfig& config, const TrainHooks& hooks) const {
    try {
      Trainer(finalize(config, scene), scene, folder, hooks).run();
    } catch (const IoError& error) {
      return error.what();
    }
    return "";
  }
  static bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const ModelFolder folder{temp / "model"};
  std::vector<std::string> warnings;
};

TEST_F(TrainerFiles, ASaveThatFailedIsForgottenOnceItHasBeenReported) {
  TrainConfig config = eventful_config();
  config.densification_interval = 10;  // so that the density control of the last iteration waits for the last PLY
  const Trained whole = train(config, scene, temp / "whole");
  std::unique_ptr<Trainer> trainer;
  std::vector<fs::path> saved;
  int n_failed = 0;
  TrainHooks hooks;
  hooks.wants_model = [] { return true; };
  hooks.on_model = [&](const ModelInTraining& model) {
    if (model.iteration == 5) {
      const FileSizeLimit limit(5000);
      try {
        trainer->save();
      } catch (const IoError&) {
        ++n_failed;
      }
      EXPECT_FALSE(fs::exists(folder.ply(5)));
    }
    if (model.iteration == 5 || model.iteration == 6) saved.push_back(trainer->save());
  };
  trainer = std::make_unique<Trainer>(finalize(config, scene), scene, folder, hooks);
  const TrainResult result = trainer->run();
  EXPECT_EQ(n_failed, 1);
  EXPECT_TRUE(result.not_written.empty()) << "it was written at the second try";
  EXPECT_EQ(saved, (std::vector<fs::path>{folder.checkpoint(5), folder.checkpoint(6)}));
  EXPECT_EQ(folder.ply_iterations(), (std::vector<int>{5, 6, 20})) << "what is saved can be viewed";
  EXPECT_TRUE(test::same(test::read_bytes(result.ply), whole.ply));
  EXPECT_EQ(result.n_gaussians, whole.result.n_gaussians) << "without its last density control";
}

TEST_F(TrainerFiles, ASaveWithoutItsPlyHasSucceeded) {
  std::unique_ptr<Trainer> trainer;
  TrainHooks hooks;
  hooks.on_warning = [&](const std::string& warning) { warnings.push_back(warning); };
  std::unique_ptr<FileSizeLimit> limit;
  hooks.on_progress = [&](const TrainProgress& progress) {
    if (progress.iteration == 5 && progress.activity == "saving" && !limit)
      limit = std::make_unique<FileSizeLimit>(5000);
  };
  hooks.wants_model = [&] { return trainer->iteration() == 5; };
  hooks.on_model = [&](const ModelInTraining&) {
    EXPECT_EQ(trainer->save(), folder.checkpoint(5));
    limit.reset();
  };
  trainer = std::make_unique<Trainer>(finalize(eventful_config(), scene), scene, folder, hooks);
  const TrainResult result = trainer->run();
  EXPECT_EQ(result.ply, folder.ply(20));
  EXPECT_EQ(result.not_written, (std::vector<fs::path>{folder.ply(5)}));
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(has(warnings[0], folder.ply(5).string())) << warnings[0];
}

TEST_F(TrainerFiles, ACompleteModelWithoutItsCheckpointIsSaidToBeComplete) {
  for (const bool has_earlier : {false, true}) {
    remove_tree(folder.root());
    TrainConfig config = eventful_config();
    if (has_earlier) config.checkpoint_iterations = {16};
    TrainHooks hooks;
    std::unique_ptr<FileSizeLimit> limit;
    hooks.on_progress = [&](const TrainProgress& progress) {
      if (progress.iteration == 20 && progress.activity == "checkpoint" && !limit)
        limit = std::make_unique<FileSizeLimit>(5000);
    };
    const std::string error = error_of(config, hooks);
    limit.reset();
    EXPECT_TRUE(has(error, folder.checkpoint(20).string() + " (")) << error;
    EXPECT_TRUE(has(error, "the PLY of iteration 20 is complete: " + folder.ply(20).string())) << error;
    EXPECT_TRUE(has(error, "only the checkpoint is missing")) << error;
    EXPECT_EQ(has(error, folder.checkpoint(16).string()), has_earlier) << error;
    EXPECT_FALSE(has(error, "--overwrite")) << error;
    EXPECT_TRUE(fs::exists(folder.ply(20)));
  }
}

TEST_F(TrainerFiles, NoAdviceDestroysAnEarlierPly) {
  for (const bool has_earlier : {false, true}) {
    TrainConfig config = eventful_config();
    if (has_earlier) config.save_iterations = {8, 20};
    TrainHooks hooks;
    std::unique_ptr<FileSizeLimit> limit;
    hooks.on_progress = [&](const TrainProgress& progress) {
      if (progress.iteration == 20 && !limit) limit = std::make_unique<FileSizeLimit>(5000);
    };
    const std::string error = error_of(config, hooks);
    limit.reset();
    EXPECT_TRUE(has(error, "last checkpoint: none was written; start the training again")) << error;
    EXPECT_EQ(has(error, "in another folder (-m)"), has_earlier) << error;
    EXPECT_FALSE(has(error, "--overwrite")) << error;
    EXPECT_EQ(fs::exists(folder.ply(8)), has_earlier);
  }
}

}  // namespace
}  // namespace b3dgs
