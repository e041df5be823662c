// Runs the program. Tests which checkpoints can be resumed in which folders.
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>

#include "config/train_options.h"
#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "model/model_folder.h"
#include "support/files.h"
#include "support/page_data.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/write_checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

class Resume : public ::testing::Test {
 protected:
  Resume() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "500", "--views", "6", "--width", "48", "--height", "36", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  std::string scene() const { return (temp.path() / "scene").string(); }
  static Outcome train(Words words, const test::RunOptions& options = {}) {
    words.insert(words.begin(), "train");
    return run_b3dgs(words, options);
  }
  static void expect_success(const Outcome& outcome) { EXPECT_EQ(outcome.exit_code, 0) << outcome.err; }
  static void expect_refused(const Outcome& outcome, const std::vector<std::string>& parts) {
    EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
    for (const std::string& part : parts) {
      EXPECT_NE(outcome.err.find(part), std::string::npos) << part << " in " << outcome.err;
    }
  }

  test::TempDir temp;
  const ModelFolder a{temp / "a"}, b{temp / "b"};
};

TEST_F(Resume, OfOneModelDoesNotReplaceAnotherUnlessAsked) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "6", "--checkpoint_iterations", "3"}));
  expect_success(train({"-s", scene(), "-m", b.root(), "--iterations", "5", "--seed", "3"}));
  const std::string ply = read_bytes(b.ply(5)), log = read_bytes(b.log());
  const Words resume{"--resume", a.checkpoint(3), "-m", b.root()};
  const Outcome refused = train(resume);
  expect_refused(refused, {b.root(), "another training", "--overwrite"});
  EXPECT_EQ(std::count(refused.err.begin(), refused.err.end(), '\n'), 1) << refused.err;
  EXPECT_TRUE(test::same(read_bytes(b.ply(5)), ply));
  EXPECT_EQ(read_bytes(b.log()), log);

  // If this folder were used, the checkpoint would be removed with the model.
  const fs::path guest = b.checkpoint(3);
  fs::copy_file(a.checkpoint(3), guest);
  expect_refused(train({"--resume", guest, "-m", b.root(), "--overwrite"}), {guest, "move it elsewhere"});
  EXPECT_TRUE(fs::exists(guest));
  EXPECT_TRUE(test::same(read_bytes(b.ply(5)), ply));
  fs::remove(guest);

  Words asked = resume;
  asked.emplace_back("--overwrite");
  expect_success(train(asked));
  EXPECT_EQ(b.ply_iterations(), (std::vector<int>{6}));
  EXPECT_TRUE(fs::exists(a.checkpoint(3)));
}

TEST_F(Resume, ContradictsOverwriteInTheFolderOfTheSameTraining) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "6", "--checkpoint_iterations", "3"}));
  const std::string ply = read_bytes(a.ply(6));
  expect_refused(train({"--resume", "auto", "-m", a.root(), "--overwrite"}), {"exclude each other"});
  expect_refused(train({"--resume", a.checkpoint(3), "--overwrite"}), {"nothing to replace", a.root()});
  EXPECT_TRUE(test::same(read_bytes(a.ply(6)), ply));
}

TEST_F(Resume, AcceptsAFolderAndReportsTheIterations) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "6", "--checkpoint_iterations", "3"}));
  const Outcome more = train({"--resume", a.root(), "--iterations", "10", "--kernel", "naive"});
  expect_success(more);
  EXPECT_NE(more.out.find("4 iterations (7 to 10) in"), std::string::npos) << more.out;
  const auto report = test::data_of_page(read_bytes(a.root() / "report.html"));
  EXPECT_EQ(report["runs"][0]["resumes"][0]["kernel"], "naive") << "the kernel was changed by an option";
  EXPECT_EQ(train({"--resume", temp / "scene"}).exit_code, 2);

  // Resuming an earlier checkpoint sets the later files aside; eval uses the new ones.
  const Outcome back = train({"--resume", a.checkpoint(6), "--iterations", "8"});
  expect_success(back);
  EXPECT_NE(back.err.find("set_aside"), std::string::npos) << back.err;
  EXPECT_TRUE(fs::exists(a.root() / "set_aside/after_iteration_6_1/point_cloud/iteration_10/point_cloud.ply"));
  const Outcome measured = run_b3dgs({"eval", "-m", a.root()});
  expect_success(measured);
  EXPECT_NE(measured.out.find("iteration 8,"), std::string::npos) << measured.out;
}

TEST_F(Resume, OfACompleteTrainingInAnotherFolderWritesItsFilesThere) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "6"}));
  const Outcome copied = train({"--resume", a.checkpoint(6), "-m", b.root()});
  expect_success(copied);
  EXPECT_NE(copied.out.find("checkpoint  " + b.checkpoint(6).string()), std::string::npos) << copied.out;
  EXPECT_TRUE(test::same(read_bytes(b.ply(6)), read_bytes(a.ply(6))));
  EXPECT_EQ(b.checkpoint_iterations(), std::vector<int>{6});

  const Words kernel{"--kernel", "naive"};  // results do not depend on times
  for (const ModelFolder& folder : {a, b}) {
    Words more{"--resume", folder.root(), "--iterations", "9"};
    more.insert(more.end(), kernel.begin(), kernel.end());
    expect_success(train(more));
  }
  EXPECT_TRUE(test::same(read_bytes(b.ply(9)), read_bytes(a.ply(9))));
}

TEST_F(Resume, TheCommandLineWithAPresetCanBeRepeated) {
  const Words words{"-s",
                    scene(),
                    "-m",
                    a.root(),
                    "--resume",
                    "auto",
                    "--preset",
                    "fast",
                    "--iterations",
                    "16",
                    "--steps_scaler",
                    "0.5",
                    "--checkpoint_iterations",
                    "6"};
  const Outcome first = train(words);
  expect_success(first);
  EXPECT_NE(first.out.find("options     preset fast, strategy "), std::string::npos) << first.out;
  EXPECT_EQ(first.out.find("position_lr_max_steps"), std::string::npos) << "config.json has these: " << first.out;
  EXPECT_NE(first.out.find(" iterations 8"), std::string::npos) << first.out;
  const TrainConfig config = a.read_config();
  EXPECT_EQ(config.preset, "fast");
  EXPECT_EQ(config.iterations, 8);
  EXPECT_EQ(config.position_lr_max_steps, 8);
  fs::remove(a.checkpoint(8));
  const Outcome again = train(words);
  expect_success(again);
  EXPECT_NE(again.out.find("resuming " + a.checkpoint(3).string() + "\n"), std::string::npos)
      << "no changed options; " << again.out;
  EXPECT_TRUE(config_differences(config, a.read_config()).empty());
  expect_refused(train({"-m", a.root(), "--resume", "auto", "--preset", "inria"}), {"--preset inria", "fast"});
}

TEST_F(Resume, TheSameFolderNamedInAnotherWayIsNoChangedOption) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "3"}));
  const Outcome again = train({"--resume", "auto", "-m", (a.root() / ".").string(), "--iterations", "4"});
  expect_success(again);
  EXPECT_NE(again.out.find("changed options:\n  iterations: 3 -> 4\n"), std::string::npos) << again.out;
  EXPECT_EQ(again.out.find("model_path"), std::string::npos) << again.out;
}

TEST_F(Resume, WithOtherImageSizesIsRefusedBeforePhotographsAreDecoded) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "3"}));
  for (const fs::directory_entry& image : fs::directory_iterator(fs::path(scene()) / "images")) {
    fs::resize_file(image.path(), fs::file_size(image.path()) / 2);  // its header is intact
  }
  const Outcome refused = train({"--resume", a.root(), "--iterations", "5", "-r", "2"});
  expect_refused(refused, {"expected training view 0 to be 00000.png, 48 x 36 px, found 00000.png, 24 x 18 px;", "-r"});
  EXPECT_EQ(refused.err.find_first_of("{}"), std::string::npos) << refused.err;
}

TEST_F(Resume, OptionsAreCheckedBeforePhotographsAreDecoded) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "3"}));
  for (const fs::directory_entry& image : fs::directory_iterator(fs::path(scene()) / "images")) {
    fs::resize_file(image.path(), fs::file_size(image.path()) / 2);  // its header is intact
  }
  expect_refused(train({"--resume", a.root(), "--iterations", "2"}), {"is beyond --iterations 2"});
  expect_refused(train({"--resume", a.root(), "--sh_degree", "1"}), {"but --sh_degree is 1"});
  expect_refused(train({"-s", scene(), "-m", b.root(), "--init_ply", temp / "none.ply"}), {"none.ply"});
  const Outcome compared = run_b3dgs({"compare", scene(), "-m", b.root(), "--init_ply", temp / "none.ply"});
  expect_refused(compared, {"none.ply"});
}

TEST_F(Resume, AutoNeedsNoSceneAndDetectsDamagedCheckpoints) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "4", "--sh_degree", "1"}));
  fs::resize_file(a.checkpoint(4), 1000);
  expect_refused(train({"-m", a.root(), "--resume", "auto"}), {"all checkpoints are damaged", "--overwrite"});
  expect_success(train({"--config", a.root() / "config.json", "--overwrite", "--iterations", "5"}));
  EXPECT_EQ(a.checkpoint_iterations(), (std::vector<int>{5}));

  // The training seems to have been killed before the first checkpoint.
  fs::remove(a.checkpoint(5));
  EXPECT_TRUE(remove_tree(a.root() / "point_cloud"));
  expect_success(train({"-m", a.root(), "--resume", "auto"}));
  EXPECT_EQ(a.read_config().sh_degree, 1);
  EXPECT_EQ(a.ply_iterations(), (std::vector<int>{5}));
}

TEST_F(Resume, AutoWithNothingToResumeAndNoSceneIsOneLine) {
  const Outcome outcome = train({"--resume", "auto", "-m", temp / "none"});
  expect_refused(outcome, {"nothing to resume: ", temp / "none", "b3dgs train SOURCE_PATH"});
  EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  EXPECT_FALSE(fs::exists(temp / "none"));
}

TEST_F(Resume, OverwriteKeepsTheModelIfTheTrainingReadsItsGaussians) {
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "5"}));
  const std::string ply = read_bytes(a.ply(5));
  const Words words{"-s", scene(), "-m", a.root(), "--iterations", "3", "--overwrite"};
  Words from_itself = words;
  from_itself.insert(from_itself.end(), {"--init_ply", a.ply(5)});
  expect_refused(train(from_itself), {"--init_ply", a.ply(5), "copy it elsewhere"});
  EXPECT_TRUE(test::same(read_bytes(a.ply(5)), ply));
  const fs::path guest = a.ply(5).parent_path() / "scene";
  fs::copy(scene(), guest, fs::copy_options::recursive);
  Words of_guest = words;
  of_guest[1] = guest.string();
  expect_refused(train(of_guest), {"-s", guest, "copy it elsewhere"});
  EXPECT_TRUE(fs::exists(guest / "images"));
  expect_success(train(words));
  EXPECT_FALSE(fs::exists(a.ply(5)));
}

TEST_F(Resume, FilesThatAreNotOfATrainingAreKept) {
  for (const char* name : {"poses.json", "exposure.json", "report/notes.txt"}) {
    fs::create_directories((a.root() / name).parent_path());
    write_file(a.root() / name, "mine");
  }
  expect_success(train({"-s", scene(), "-m", a.root(), "--iterations", "2", "--overwrite"}));
  // Files that would be mistaken for a part of the new model are moved aside.
  for (const char* name : {"poses.json.previous", "exposure.json.previous", "report/notes.txt"}) {
    EXPECT_EQ(read_bytes(a.root() / name), "mine") << name;
  }
}

TEST_F(Resume, ATrainingInTheFolderOfAComparisonIsRefused) {
  fs::create_directories(a.root());
  write_file(a.root() / "compare.json", "{}");
  expect_refused(train({"-s", scene(), "-m", a.root(), "--overwrite"}), {"holds a comparison", "-m"});
  EXPECT_EQ(read_bytes(a.root() / "compare.json"), "{}");
}

TEST_F(Resume, ASecondTrainingInAFolderIsRefused) {
  Outcome second;
  test::RunOptions options;
  options.signal = SIGTERM;
  options.signal_when = [&] {
    if (a.checkpoint_iterations().empty()) return false;
    second = train({"-m", a.root(), "--resume", "auto"});
    return true;
  };
  const Outcome first =
      train({"-s", scene(), "-m", a.root(), "--iterations", "1000000", "--checkpoint_iterations", "5"}, options);
  EXPECT_EQ(first.exit_code, 143) << first.err;
  expect_refused(second, {"model folder in use: ", a.root(), " train -s "});
}

TEST_F(Resume, AFullDiskDuringTrainingDoesNotEndIt) {
  test::RunOptions full;
  full.file_size_limit = 60000;
  const Outcome outcome =
      train({"-s", scene(), "-m", a.root(), "--iterations", "8", "--checkpoint_iterations", "4", "--quiet"}, full);
  expect_refused(outcome, {"warning: ", "cannot write ", "iteration_4.b3dgs", "error: ", "File too large"});
  EXPECT_NE(outcome.err.find("last checkpoint: none was written; start the training again"), std::string::npos)
      << outcome.err;
}

}  // namespace
}  // namespace b3dgs
