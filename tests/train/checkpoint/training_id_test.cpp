// Tests which training a model folder belongs to, and that files of later iterations are moved aside when it is
// resumed.

#include "model/model_folder.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::eventful_config;
using test::read_bytes;
using test::train;
using test::Trained;

class TrainingId : public testing::Test {
 protected:
  /// Returns a config of 20 iterations with checkpoints and PLYs at 8, 16 and 20.
  static TrainConfig config() {
    TrainConfig config = eventful_config();
    config.checkpoint_iterations = config.save_iterations = config.test_iterations = {8, 16};
    config.keep_checkpoints = 9;
    return config;
  }
  /// Returns the contents of all regular files below a folder, by relative path.
  static std::map<std::string, std::string> files_of(const fs::path& folder) {
    std::map<std::string, std::string> files;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder)) {
      if (entry.is_regular_file()) {
        files[entry.path().lexically_relative(folder).string()] = read_bytes(entry.path());
      }
    }
    return files;
  }
  void resume(const fs::path& checkpoint, const fs::path& into) const { train(config(), scene, into, checkpoint); }

  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const ModelFolder a{temp / "a"}, b{temp / "b"};
};

TEST_F(TrainingId, KeepsTrainingsOutOfEachOthersFolders) {
  train(config(), scene, a.root());
  TrainConfig other = config();
  other.seed = 10;
  train(other, scene, b.root());
  const auto before = files_of(b.root());
  EXPECT_TRUE(test::fails_with<InputError>({b.root().string(), "another training", "--overwrite"},
                                           [&] { resume(a.checkpoint(8), b.root()); }));
  EXPECT_TRUE(test::same(files_of(b.root()), before)) << "the refused training changed files";
  EXPECT_TRUE(test::fails_with<InputError>({b.root().string(), "holds the model of another training"},
                                           [&] { Trainer(finalize(config(), scene), scene, b, {}).run(); }));
  EXPECT_TRUE(test::same(files_of(b.root()), before)) << "a training from the beginning changed files";

  // In an empty folder the training continues under a new ID.
  resume(a.checkpoint(8), temp / "c");
  EXPECT_TRUE(test::same(read_bytes(ModelFolder(temp / "c").ply(20)), read_bytes(a.ply(20))));
  EXPECT_FALSE(ModelFolder(temp / "c").training_id().empty());
  EXPECT_NE(ModelFolder(temp / "c").training_id(), a.training_id());
  EXPECT_TRUE(test::fails_with<InputError>({"another training"}, [&] { resume(a.checkpoint(8), temp / "c"); }));
  resume(ModelFolder(temp / "c").checkpoint(20), temp / "c");
}

TEST_F(TrainingId, ResumingAnEarlierCheckpointSetsLaterFilesAside) {
  train(config(), scene, a.root());
  for (const char* set : {"test/ours_8", "test/ours_16", "interpolated/ours_20"}) {
    test::write_bytes(a.root() / set / "renders" / "00000.png", set);
  }
  test::write_bytes(a.root() / "report.html", "of 20");
  const auto before = files_of(a.root());
  TrainConfig shorter = config();
  shorter.iterations = 12;
  train(shorter, scene, a.root(), a.checkpoint(8));

  EXPECT_EQ(a.ply_iterations(), (std::vector<int>{8, 12})) << "b3dgs eval uses the last one";
  EXPECT_EQ(a.checkpoint_iterations(), (std::vector<int>{8, 12}));
  EXPECT_TRUE(fs::exists(a.root() / "test/ours_8"));
  EXPECT_FALSE(fs::exists(a.root() / "test/ours_16"));
  const auto results = nlohmann::json::parse(read_bytes(a.root() / "results.json"));
  EXPECT_TRUE(results.contains("ours_8") && results.contains("ours_12") && !results.contains("ours_16")) << results;

  const fs::path aside = a.root() / "set_aside" / "after_iteration_8_1";
  for (const char* file : {"checkpoints/iteration_16.b3dgs", "checkpoints/iteration_20.b3dgs",
                           "point_cloud/iteration_16/point_cloud.ply", "point_cloud/iteration_20/point_cloud.ply",
                           "test/ours_16/renders/00000.png", "interpolated/ours_20/renders/00000.png", "report.html"}) {
    EXPECT_TRUE(test::same(read_bytes(aside / file), before.at(file))) << file;
  }
  EXPECT_EQ(nlohmann::json::parse(read_bytes(aside / "results.json")).size(), 2u);
  std::ifstream log(aside / "train.jsonl");
  int n_lines = 0;
  for (std::string line; std::getline(log, line); ++n_lines) EXPECT_GT(nlohmann::json::parse(line)["iteration"], 8);
  EXPECT_GE(n_lines, 3) << "the lines of iterations 10, 16 and 20";

  // The second time, files that were moved aside before stay, and later ones go to another folder.
  train(shorter, scene, a.root(), a.checkpoint(8));
  EXPECT_TRUE(fs::exists(aside / "checkpoints/iteration_20.b3dgs"));
  EXPECT_TRUE(fs::exists(a.root() / "set_aside/after_iteration_8_2/checkpoints/iteration_12.b3dgs"));
}

TEST_F(TrainingId, ResumingTheNewestCheckpointSetsOnlyLaterLogLinesAside) {
  TrainConfig half = config();
  half.iterations = 16;
  train(half, scene, a.root());
  std::ofstream(a.log(), std::ios::app) << "{\"iteration\": 17}\n";  // as a killed training may leave it
  train(config(), scene, a.root(), a.checkpoint(16));
  const fs::path aside = a.root() / "set_aside/after_iteration_16_1";
  EXPECT_EQ(read_bytes(aside / "train.jsonl"), "{\"iteration\": 17}\n");
  EXPECT_EQ(std::distance(fs::directory_iterator(aside), fs::directory_iterator()), 1);
}

TEST(FolderLock, RefusesASecondTrainingAndNamesTheFirst) {
  const test::TempDir temp;
  const fs::path folder = temp / "model";
  const std::string own = std::to_string(::getpid());
  {
    const FolderLock lock(folder);
    EXPECT_TRUE(test::fails_with<InputError>({folder.string(), "process " + own, "train_tests"},
                                             [&] { FolderLock second(folder); }));
  }
  EXPECT_FALSE(fs::exists(folder)) << "made by the lock, and still empty";
  fs::create_directory(folder);
  { const FolderLock again(folder); }
  EXPECT_TRUE(fs::is_empty(folder)) << "the lock file is removed, a user's folder is not";
}

TEST(FolderLock, EndsWithItsProcess) {
  const test::TempDir temp;
  const fs::path folder = temp / "model";
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    const FolderLock lock(folder);
    AtomicFile half(folder / "half");
    half.write(std::string("half a file"));
    if (::write(ready[1], "x", 1) != 1) ::_exit(1);
    ::pause();
  }
  char byte = 0;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1);
  EXPECT_TRUE(test::fails_with<InputError>({"process " + std::to_string(child)}, [&] { FolderLock lock(folder); }));
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  ::close(ready[0]);
  ::close(ready[1]);
  {
    const FolderLock lock(folder);
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), fs::directory_iterator()), 1)
        << "the unfinished file was removed, the lock file remains";
  }
  EXPECT_TRUE(fs::is_empty(folder));
}

TEST(DiskSpace, PredictsTheSizesOfTheFiles) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 4;  // before density control
  const Trained run = train(config, scene, temp / "m");
  const std::int64_t n = run.result.n_gaussians;
  const auto ply = static_cast<std::int64_t>(run.ply.size());
  EXPECT_GT(ply, ply_bytes(n, 1));
  EXPECT_LT(ply, ply_bytes(n, 1) + 1000) << "more than a header";
  EXPECT_GT(free_disk_bytes(temp.path()), 0);
  EXPECT_EQ(free_disk_bytes(temp / "none"), -1);

  // Tests the statistics of every strategy, 3D filters and appearance.
  TrainConfig budget = config, filtered = config, grids = config, exposures = config;
  budget.strategy = Strategy::kBudget;
  filtered.antialiasing = true;
  grids.bilateral_grid = true;
  exposures.exposure = true;
  int i = 0;
  for (const TrainConfig& own : {config, budget, filtered, grids, exposures}) {
    const fs::path folder = temp / std::to_string(i++);
    const fs::path path = train(own, scene, folder).result.checkpoint;
    const TrainState state = read_checkpoint(path, scene, torch::kCPU).state;
    const auto bytes = static_cast<std::int64_t>(fs::file_size(path));
    EXPECT_GT(bytes, checkpoint_bytes(state)) << i;
    EXPECT_LT(bytes, checkpoint_bytes(state) + 16000) << i << ": more than a header";
    TrainState of_ranks = state;
    of_ranks.n_of_all_ranks = 3 * n;
    EXPECT_GT(checkpoint_bytes(of_ranks), checkpoint_bytes(state) + 2 * n * 250) << i;
  }

  const FirstFiles files{n, 100, 1000};
  EXPECT_EQ(disk_warning("model", 3100, files, 2), "");
  EXPECT_EQ(disk_warning("model", -1, files, 2), "") << "free space unknown";
  EXPECT_NE(disk_warning("model", 3099, files, 2).find("model: "), std::string::npos);
}

}  // namespace
}  // namespace b3dgs
