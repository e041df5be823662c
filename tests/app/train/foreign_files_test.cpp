// Runs the program. Files that it has not written are never lost, regardless of the order of commands.
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "core/files/folders.h"
#include "core/files/own_files.h"
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
using test::write_bytes;
using Words = std::vector<std::string>;

class ForeignFiles : public ::testing::Test {
 protected:
  ForeignFiles() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "300", "--views", "5", "--width", "32", "--height", "24", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }

  std::string scene() const { return (temp_.path() / "scene").string(); }
  std::string model() const { return (temp_.path() / "model").string(); }

  static Outcome run(const Words& words) {
    Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << words.front() << ": " << outcome.err;
    return outcome;
  }
  Outcome train(const Words& more = {}) const {
    Words words{"train", scene(), "-m", model(), "--iterations", "4", "--eval", "--quiet"};
    words.insert(words.end(), more.begin(), more.end());
    return run(words);
  }

  /// Writes a file as the user, unless it exists.
  void put(const fs::path& file) {
    if (fs::exists(file) && contents_.count(read_bytes(file)) > 0) return;
    const std::string content = "of the user: " + file.string() + " " + std::to_string(contents_.size());
    contents_.insert(content);
    write_bytes(file, content);
  }

  /// Checks that all contents of the user are still in some file, whatever its name.
  void expect_nothing_is_lost(const std::string& after) const {
    std::set<std::string> found;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(temp_.path())) {
      if (entry.is_regular_file() && entry.file_size() < 1000) found.insert(read_bytes(entry.path()));
    }
    for (const std::string& content : contents_) EXPECT_EQ(found.count(content), 1u) << content << " after " << after;
  }

  /// Puts a file of the user at each path where the program writes, or might look. `with_inputs`: also where a command
  /// that does not start anew would read it, and fail.
  void put_everywhere(bool with_inputs) {
    const fs::path root = model();
    for (const char* name : {"cfg_args", "input.ply", "photographs.json", "report.html", "results.json",
                             "per_view.json", "report/notes.txt", "test/ours_4/renders/00000.png", "test/notes.txt",
                             "train/ours_4/gt/00000.png", "point_cloud/notes.txt", "point_cloud/iteration_4/edited.ply",
                             "checkpoints/notes.txt", "set_aside/notes.txt", "replaced/notes.txt", "compare.html"}) {
      put(root / name);
    }
    if (!with_inputs) return;
    for (const char* name : {"config.json", "cameras.json", "poses.json", "exposure.json", "train.jsonl",
                             "report/run.json", "report/truth_00000.png", "point_cloud/iteration_4/exposure.json"}) {
      put(root / name);
    }
  }

  test::TempDir temp_;
  std::set<std::string> contents_;
};

TEST_F(ForeignFiles, InAFolderWithoutAModelAreKept) {
  put_everywhere(/*with_inputs=*/true);
  const Outcome first = train();
  expect_nothing_is_lost("train");
  EXPECT_NE(first.err.find("config.json was not written by this program"), std::string::npos) << first.err;
  EXPECT_NE(first.err.find("kept as config.json.previous"), std::string::npos) << first.err;
  EXPECT_EQ(ModelFolder(model()).read_config().iterations, 4);
  run({"eval", model(), "--save_images", "--quiet"});
  expect_nothing_is_lost("eval");
}

TEST_F(ForeignFiles, OutliveEveryCommandInEveryOrder) {
  const std::vector<Words> commands{
      {"train", scene(), "-m", model(), "--iterations", "4", "--eval", "--overwrite", "--quiet"},
      {"eval", model(), "--save_images", "--split", "all", "--quiet"},
      {"render", model(), "--quiet"},
      {"report", model()},
      {"train", "--resume", "auto", "-m", model(), "--iterations", "6", "--quiet"}};
  std::vector<std::size_t> order;  // each command after each other one, and after itself
  for (std::size_t i = 0; i < commands.size(); ++i) {
    order.push_back(i);
    for (std::size_t j = i + 1; j < commands.size(); ++j) order.insert(order.end(), {i, j});
  }
  order.push_back(0);
  train();
  for (const std::size_t i : order) {
    put_everywhere(/*with_inputs=*/i == 0);
    run(commands[i]);
    expect_nothing_is_lost(commands[i].front());
    if (HasFailure()) break;
  }
}

TEST_F(ForeignFiles, OfAModelThatIsReplacedStay) {
  train();
  run({"eval", model(), "--save_images", "--quiet"});
  const fs::path root = model(), iteration = root / "point_cloud/iteration_4";
  put(iteration / "web.spz");
  put(iteration / "point_cloud_orbit/00000.png");
  put(root / "report/notes.txt");
  put(root / "checkpoints/iteration_4.b3dgs");  // edited, or from elsewhere, so it must not be resumed
  write_bytes(root / "test/ours_4/views.json", "[]");
  const Outcome replaced = train({"--overwrite", "--iterations", "3"});
  expect_nothing_is_lost("--overwrite");
  EXPECT_TRUE(fs::exists(iteration / "web.spz"));
  EXPECT_TRUE(fs::exists(root / "report/notes.txt"));
  EXPECT_TRUE(fs::exists(root / "set_aside/replaced_1/checkpoints/iteration_4.b3dgs"));
  EXPECT_NE(replaced.err.find("set_aside/replaced_1"), std::string::npos) << replaced.err;
  EXPECT_EQ(ModelFolder(root).ply_iterations(), std::vector<int>{3});
  EXPECT_FALSE(fs::exists(root / "test/ours_4/renders/00000.png")) << "renders of the model that is gone";
  EXPECT_EQ(read_bytes(root / "results.json").find("ours_4"), std::string::npos);
  EXPECT_FALSE(fs::exists(root / "replaced")) << "the new model is complete";
}

TEST_F(ForeignFiles, AModelIsKeptUntilItsSuccessorIsComplete) {
  train();
  const std::string ply = read_bytes(ModelFolder(model()).ply(4));
  const fs::path kept = fs::path(model()) / "replaced/point_cloud/iteration_4/point_cloud.ply";
  for (int i = 0; i < 3; ++i) {  // stopped three times: the complete model stays, not the unfinished one
    fs::remove(fs::path(model()) / "train.jsonl");
    test::RunOptions killed;
    killed.signal = i == 0 ? SIGKILL : SIGINT;  // the second leaves a PLY of an unfinished training
    killed.signal_when = [&] { return fs::exists(fs::path(model()) / "train.jsonl") && fs::exists(kept); };
    run_b3dgs({"train", scene(), "-m", model(), "--iterations", "100000", "--overwrite", "--quiet"}, killed);
    ASSERT_TRUE(test::same(read_bytes(kept), ply));
    EXPECT_EQ(ModelFolder(model()).ply_iterations().size(), i == 0 ? 0u : 1u);
  }
  train({"--overwrite", "--iterations", "5"});
  EXPECT_FALSE(fs::exists(kept));
  EXPECT_EQ(ModelFolder(model()).ply_iterations(), std::vector<int>{5});
}

TEST_F(ForeignFiles, AModelIsKeptIfItsMoveWasInterrupted) {
  train();
  const fs::path root = model();
  {
    OwnFiles own(root);  // files left by a process that is killed while it moves them
    fs::create_directories(root / "replaced.moving/checkpoints");
    own.move(ModelFolder(model()).checkpoint(4), root / "replaced.moving/checkpoints/iteration_4.b3dgs");
  }
  test::RunOptions stopped;
  stopped.signal = SIGKILL;
  stopped.signal_when = [&] { return fs::exists(root / "replaced") && !fs::exists(root / "replaced.moving"); };
  run_b3dgs({"train", scene(), "-m", model(), "--iterations", "100000", "--overwrite", "--quiet"}, stopped);
  EXPECT_TRUE(fs::exists(root / "replaced/checkpoints/iteration_4.b3dgs"));
  EXPECT_TRUE(fs::exists(root / "replaced/point_cloud/iteration_4/point_cloud.ply"));
  const std::string kept = (root / "replaced/checkpoints/iteration_4.b3dgs").string();
  const Outcome resumed = run_b3dgs({"train", "--resume", kept, "--iterations", "5", "--quiet"});
  EXPECT_EQ(resumed.exit_code, 2);
  EXPECT_NE(resumed.err.find("elsewhere first, and resume it there"), std::string::npos) << resumed.err;
}

TEST_F(ForeignFiles, PartsThatCannotBeMovedInOneStepStay) {
  fs::create_directories(fs::path(model()));
  fs::create_directory(temp_.path() / "big");
  fs::create_directory_symlink("../big", fs::path(model()) / "checkpoints");
  train();
  const Outcome again = run_b3dgs({"train", scene(), "-m", model(), "--iterations", "4", "--overwrite", "--quiet"});
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_NE(again.err.find("checkpoints: is a link, or on another disk"), std::string::npos) << again.err;
  EXPECT_TRUE(fs::exists(ModelFolder(model()).ply(4)));
  EXPECT_TRUE(fs::exists(temp_.path() / "big/iteration_4.b3dgs"));
}

TEST_F(ForeignFiles, LinksInThePlaceOfLockAndRecordAreNotFollowed) {
  for (const char* name : {".b3dgs-lock", ".b3dgs-files"}) {
    remove_tree(model());
    fs::create_directories(model());
    put(temp_.path() / (std::string("of_user") + name));
    fs::create_symlink("../of_user" + std::string(name), fs::path(model()) / name);
    const Outcome outcome = run_b3dgs({"train", scene(), "-m", model(), "--iterations", "4", "--quiet"});
    EXPECT_EQ(outcome.exit_code, name == std::string(".b3dgs-lock") ? 2 : 0) << outcome.err;
    expect_nothing_is_lost(name);
  }
}

TEST_F(ForeignFiles, InThePlaceOfFoldersAreMovedAside) {
  for (const char* name : {"point_cloud", "checkpoints"}) put(fs::path(model()) / name);
  train();
  expect_nothing_is_lost("train");
  EXPECT_EQ(ModelFolder(model()).ply_iterations(), std::vector<int>{4});
  EXPECT_EQ(ModelFolder(model()).checkpoint_iterations(), std::vector<int>{4});
}

TEST_F(ForeignFiles, InputsAtPlacesOfOutputsAreRefused) {
  const fs::path root = model();
  for (const Words& more :
       {Words{"--init_ply", (root / "input.ply").string()}, Words{"--masks", (root / "report").string()},
        Words{"--depths", (root / "point_cloud").string()}}) {
    Words words{"train", scene(), "-m", model(), "--iterations", "4", "--quiet"};
    words.insert(words.end(), more.begin(), more.end());
    fs::create_directories(root / "report"), fs::create_directories(root / "point_cloud");
    write_bytes(root / "input.ply", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n");
    const Outcome refused = run_b3dgs(words);
    EXPECT_EQ(refused.exit_code, 2);
    EXPECT_NE(refused.err.find("copy it elsewhere first"), std::string::npos) << refused.err;
  }
  const Outcome scene_itself = run_b3dgs({"train", scene(), "-m", scene(), "--iterations", "4", "--quiet"});
  EXPECT_EQ(scene_itself.exit_code, 2);
  EXPECT_NE(scene_itself.err.find("choose another folder with -m"), std::string::npos) << scene_itself.err;
}

}  // namespace
}  // namespace b3dgs
