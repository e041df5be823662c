// --max_epochs, run as a program: trainings with few photographs.
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "config/train_options.h"
#include "core/files/atomic_file.h"
#include "model/model_folder.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

const std::string kLine = "schedule    12 iterations: each photograph 2 times (--max_epochs)\n";

class MaxEpochs : public ::testing::Test {
 protected:
  MaxEpochs() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "300", "--views", "6", "--width", "48", "--height", "36", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  std::string scene() const { return (temp / "scene").string(); }
  ModelFolder model(const std::string& name = "model") const { return ModelFolder(temp / name); }

  /// The kernels are fixed, so that timing does not make two trainings differ.
  Outcome train(const Words& more, const std::string& name = "model") const {
    Words words{"train", scene(),     "-m", model(name).root(), "--device",
                "cpu",   "--threads", "1",  "--kernel",         "combined"};
    words.insert(words.end(), more.begin(), more.end());
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    return outcome;
  }

  const test::TempDir temp;
};

TEST_F(MaxEpochs, EndsATrainingAndItsSchedule) {
  const Outcome outcome = train({"--preset", "quality", "--max_epochs", "2", "--position_lr_max_steps", "500"});
  EXPECT_NE(outcome.out.find(kLine), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("schedule x 0.0005 for --max_epochs\n"), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("trained     12 iterations in "), std::string::npos) << outcome.out;
  EXPECT_EQ(model().ply_iterations(), std::vector<int>{12});
  EXPECT_EQ(model().checkpoint_iterations(), std::vector<int>{12});
  const TrainConfig config = model().read_config();
  EXPECT_EQ(config.iterations, 12);
  EXPECT_EQ(config.max_epochs, 2);
  EXPECT_EQ(config.densify_until_iter, 8) << "two thirds, as always";
  EXPECT_EQ(config.position_lr_max_steps, 500) << "was given";
  const Outcome info = run_b3dgs({"info", model().root()});
  EXPECT_NE(info.out.find("iterations              12\n"), std::string::npos) << info.out;
}

TEST_F(MaxEpochs, CountsTrainingPhotographsAndNotSteps) {
  const Outcome outcome = train({"--max_epochs", "2", "--eval", "--batch", "4"});  // view 0 is held out
  EXPECT_EQ(model().ply_iterations(), std::vector<int>{10}) << outcome.out;
}

TEST_F(MaxEpochs, DoesNotLimitGivenIterations) {
  const Outcome outcome = train({"--iterations", "14"});
  EXPECT_EQ(outcome.out.find("--max_epochs"), std::string::npos) << outcome.out;
  EXPECT_EQ(model().ply_iterations(), std::vector<int>{14});
  EXPECT_EQ(model().read_config().max_epochs, 0);
}

TEST_F(MaxEpochs, AResumedTrainingIsTheSame) {
  const Words words{"--max_epochs", "2",   "--densify_from_iter", "3", "--checkpoint_iterations", "5",
                    "--resume",     "auto"};
  train(words);
  const std::string ply = read_bytes(model().ply(12));
  const TrainConfig config = model().read_config();
  ASSERT_TRUE(fs::remove(model().checkpoint(12)));
  const Outcome resumed = train(words);
  EXPECT_NE(resumed.out.find("resuming " + model().checkpoint(5).string() + "\n"), std::string::npos)
      << "no changed options; " << resumed.out;
  EXPECT_NE(resumed.out.find(kLine), std::string::npos) << resumed.out;
  EXPECT_TRUE(config_differences(config, model().read_config()).empty());
  EXPECT_TRUE(test::same(read_bytes(model().ply(12)), ply));

  // One is longer, one shorter than the finished part.
  train({"--resume", "auto", "--iterations", "16"});
  EXPECT_EQ(model().ply_iterations(), (std::vector<int>{12, 16}));
  EXPECT_EQ(model().read_config().max_epochs, 0);
  const Outcome less = run_b3dgs({"train", "-m", model().root(), "--resume", "auto", "--max_epochs", "1"});
  EXPECT_EQ(less.exit_code, 2) << less.out;
  EXPECT_NE(less.err.find("pass a larger --iterations or --max_epochs"), std::string::npos) << less.err;
  EXPECT_EQ(model().ply_iterations(), (std::vector<int>{12, 16}));
}

TEST_F(MaxEpochs, AModelFolderOfAnOlderVersionHasNone) {
  train({"--iterations", "8"});
  // A training that was interrupted before its first checkpoint has only a config.json.
  nlohmann::ordered_json older = nlohmann::ordered_json::parse(read_bytes(model().root() / "config.json"));
  ASSERT_EQ(older.erase("max_epochs"), 1u);
  const fs::path folder = model("older").root();
  fs::create_directories(folder);
  write_file(folder / "config.json", older.dump());
  const Outcome outcome = run_b3dgs({"train", "-m", folder, "--resume", "auto"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(model("older").ply_iterations(), std::vector<int>{8});
  EXPECT_EQ(model("older").read_config().max_epochs, 0) << "not that of the preset";
}

TEST_F(MaxEpochs, RanksHaveTheSameSchedule) {
  // Two options are given, which no rank may scale.
  const Words words{"--max_epochs", "2", "--batch", "2", "--densify_from_iter", "2", "--position_lr_max_steps", "5"};
  train(words, "one");
  Words on_two = words;
  on_two.insert(on_two.end(), {"--ranks", "2"});
  const Outcome two = train(on_two, "two");
  EXPECT_NE(two.out.find(kLine), std::string::npos) << two.out;
  EXPECT_EQ(two.out.find(kLine), two.out.rfind(kLine)) << "one rank speaks: " << two.out;
  EXPECT_TRUE(test::same(read_bytes(model("one").ply(12)), read_bytes(model("two").ply(12))));
}

TEST_F(MaxEpochs, HoldsForComparisons) {
  const std::string root = model("compared").root();
  const Words words{"compare",  scene(),     "-m",
                    root,       "--no_eval", "--max_epochs",
                    "2",        "--configs", "a:naive,b:preset=fast+max_epochs=3,c:naive+iterations=5",
                    "--device", "cpu",       "--chunk",
                    "4"};
  const Outcome outcome = run_b3dgs(words);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("a, seed 0: " + kLine), std::string::npos) << outcome.err;
  EXPECT_NE(outcome.err.find("b, seed 0: schedule    18 iterations"), std::string::npos) << outcome.err;
  EXPECT_EQ(outcome.err.find("take long"), std::string::npos) << "24,000 iterations would: " << outcome.err;
  EXPECT_EQ(ModelFolder(fs::path(root) / "a/seed_0").ply_iterations(), std::vector<int>{12});
  EXPECT_EQ(ModelFolder(fs::path(root) / "b/seed_0").ply_iterations(), std::vector<int>{18});
  EXPECT_EQ(ModelFolder(fs::path(root) / "c/seed_0").ply_iterations(), std::vector<int>{5});
  const auto read_plan = [&] { return nlohmann::json::parse(read_bytes(fs::path(root) / "compare.json"))["plan"]; };
  EXPECT_EQ(read_plan()["photographs"], 6);
  EXPECT_EQ(read_plan()["config"]["densify_until_iter"], 8) << "what the configurations are compared with";

  // All runs are finished, so the scene is not read again.
  fs::rename(scene(), scene() + "_moved");
  const Outcome again = run_b3dgs({"compare", "--resume", "-m", root, "--quiet"});
  EXPECT_EQ(again.exit_code, 0) << again.err;
  fs::rename(scene() + "_moved", scene());
  EXPECT_EQ(read_plan()["photographs"], 6);

  // An additional seed, whose trainings have the same length.
  const Outcome more = run_b3dgs({"compare", "--resume", "-m", root, "--seeds", "0", "1", "--quiet"});
  ASSERT_EQ(more.exit_code, 0) << more.err;
  EXPECT_EQ(ModelFolder(fs::path(root) / "a/seed_1").ply_iterations(), std::vector<int>{12});

  // With fewer photographs for training, trainings would be shorter than those to compare with.
  const Outcome other = run_b3dgs({"compare", "--resume", "-m", root, "--seeds", "0", "1", "2", "--eval", "--quiet"});
  EXPECT_EQ(other.exit_code, 2) << other.err;
  EXPECT_NE(other.err.find("5 photographs for training, but the comparison in " + root + " began with 6"),
            std::string::npos)
      << other.err;
  EXPECT_EQ(read_plan()["photographs"], 6);
}

TEST_F(MaxEpochs, DoesNotScaleTheScheduleOfBenchStep) {
  const std::string json = (temp / "bench.json").string();
  const Outcome outcome = run_b3dgs({"bench", "step", scene(), "--device", "cpu", "--steps", "3", "--warmup", "1",
                                     "--max_epochs", "2", "--json", json});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const auto config = nlohmann::json::parse(read_bytes(json))["config"];
  EXPECT_EQ(config["densify_until_iter"], 16000);
}

}  // namespace
}  // namespace b3dgs
