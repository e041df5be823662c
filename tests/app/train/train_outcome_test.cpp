// Runs the program. Tests how a training ends if it is stopped, if nobody reads its output, or if its report cannot be
// written.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "app/common/commands.h"
#include "app/common/stop_request.h"
#include "core/files/folders.h"
#include "model/model_folder.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::run_b3dgs;
using Words = std::vector<std::string>;

class TrainOutcome : public ::testing::Test {
 protected:
  TrainOutcome() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "300", "--views", "6", "--width", "48", "--height", "36", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  std::string scene() const { return (temp.path() / "scene").string(); }
  Words training() const { return {"train", scene(), "-m", model.root().string(), "--iterations", "6"}; }
  /// Stops a long training after its first iteration.
  void interrupt() const {
    test::RunOptions options;
    options.signal = SIGTERM;
    options.signal_when = [this] { return fs::exists(model.log()) && fs::file_size(model.log()) > 0; };
    const Outcome stopped =
        run_b3dgs({"train", scene(), "-m", model.root().string(), "--iterations", "100000"}, options);
    EXPECT_EQ(stopped.exit_code, 128 + SIGTERM) << stopped.err;
  }
  /// Runs `b3dgs WORDS... REDIRECTION`.
  static Outcome run_in_shell(const Words& words, const std::string& redirection) {
    test::RunOptions options;
    options.program = "/bin/bash";
    Words all{"-c", "\"$@\" " + redirection + "; exit ${PIPESTATUS[0]}", "bash", B3DGS_PROGRAM};
    all.insert(all.end(), words.begin(), words.end());
    return run_b3dgs(all, options);
  }
  static void expect_refused(const Words& words, const std::vector<std::string>& parts) {
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 2) << words.front() << ": " << outcome.err;
    for (const std::string& part : parts) {
      EXPECT_NE(outcome.err.find(part), std::string::npos) << words.front() << ": " << part << " in " << outcome.err;
    }
  }

  test::TempDir temp;
  const ModelFolder model{temp / "model"};
};

TEST_F(TrainOutcome, DoesNotDependOnAReaderOfItsOutput) {
  for (const char* redirection : {"| true", "2>&1 | true", "> /dev/full"}) {
    SCOPED_TRACE(redirection);
    const Outcome outcome = run_in_shell(training(), redirection);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_TRUE(fs::exists(model.ply(6)) && fs::exists(model.checkpoint(6)) &&
                fs::exists(model.root() / "report.html"));
    remove_tree(model.root());
  }
  const Outcome full = run_in_shell(training(), "> /dev/full");
  EXPECT_NE(full.err.find("warning: standard output could not be written"), std::string::npos) << full.err;
}

TEST_F(TrainOutcome, WithoutAReportIsStillASuccess) {
  fs::create_directories(model.root() / "report");
  fs::permissions(model.root() / "report", fs::perms::owner_read | fs::perms::owner_exec);
  test::RunOptions options;
  options.obeys_permissions = true;
  const Outcome outcome = run_b3dgs(training(), options);
  fs::permissions(model.root() / "report", fs::perms::owner_all);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(fs::exists(model.ply(6)));
  EXPECT_NE(outcome.err.find("only the report is missing, write it with: b3dgs report " + model.root().string()),
            std::string::npos)
      << outcome.err;
}

TEST_F(TrainOutcome, WhenInterruptedCanBeShown) {
  interrupt();
  ASSERT_EQ(model.checkpoint_iterations().size(), 1u);
  EXPECT_EQ(model.ply_iterations(), model.checkpoint_iterations());
  const fs::path spz = temp / "model.spz";
  const Outcome exported = run_b3dgs({"export", model.root().string(), spz.string(), "--compare_views", "0"});
  EXPECT_EQ(exported.exit_code, 0) << exported.err;
  EXPECT_TRUE(fs::exists(spz));
}

TEST_F(TrainOutcome, WhenKilledSaysHowToContinue) {
  interrupt();
  remove_tree(model.root() / "point_cloud");  // as if the training had been killed
  ASSERT_EQ(model.checkpoint_iterations().size(), 1u);
  const int iteration = model.checkpoint_iterations().front();
  const std::string checkpoint = model.checkpoint(iteration).string(), n = std::to_string(iteration);
  const std::string to_ply = "b3dgs train --resume " + checkpoint + " --iterations " + n;
  const std::vector<std::string> parts{"interrupted at iteration " + n,
                                       "continue with b3dgs train --resume " + checkpoint, to_ply};
  expect_refused({"eval", model.root().string()}, parts);
  expect_refused({"view", model.root().string()}, parts);
  expect_refused({"render", model.root().string()}, parts);
  expect_refused({"export", model.root().string(), (temp / "model.spz").string()}, parts);
  expect_refused({"export", checkpoint, (temp / "model.spz").string()}, {checkpoint, "a checkpoint", to_ply});
  const Outcome written = run_b3dgs({"train", "--resume", checkpoint, "--iterations", n});
  EXPECT_EQ(written.exit_code, 0) << written.err;
  EXPECT_TRUE(fs::exists(model.ply(iteration)));
}

TEST_F(TrainOutcome, WhenStoppedWhilePhotographsLoadLeavesNothing) {
  std::fflush(nullptr);
  const pid_t child = ::fork();  // a stop request cannot be undone
  if (child == 0) {
    int code = 1;
    request_stop();
    try {
      code = run_train({scene(), "-m", model.root().string(), "--iterations", "6", "--quiet"});
    } catch (...) {
    }
    ::_exit(code);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 128 + SIGINT);
  EXPECT_FALSE(fs::exists(model.root()));
}

}  // namespace
}  // namespace b3dgs
