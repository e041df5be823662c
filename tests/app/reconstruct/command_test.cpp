// b3dgs reconstruct as a program: output, exit codes, Ctrl-C.
#include <gtest/gtest.h>
#include <signal.h>

#include "app/reconstruct/fake_programs.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::FakePrograms;
using test::Outcome;
using test::run_b3dgs;
using test::TempDir;

class ReconstructCommand : public testing::Test {
 protected:
  ReconstructCommand() {
    test::write_photographs(photos_, 10);
    programs_.set_models({10});
  }
  Outcome run(const test::RunOptions& options = {}) const {
    return run_b3dgs({"reconstruct", photos_, scene_}, options);
  }
  TempDir folder_;
  FakePrograms programs_;
  std::string photos_ = (folder_ / "photos").string(), scene_ = (folder_ / "scene").string();
};

TEST_F(ReconstructCommand, SaysWhatItMadeAndWhatIsNext) {
  const Outcome outcome = run();
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("10 of 10 photographs registered, 1 points, mean reprojection error 0.50 px"),
            std::string::npos)
      << outcome.out;
  EXPECT_NE(outcome.out.find("next: b3dgs train " + scene_), std::string::npos) << outcome.out;
}

TEST_F(ReconstructCommand, TooFewRegisteredAreAnInputError) {
  programs_.set_models({2});
  const Outcome outcome = run();
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("error: " + photos_ + ": only 2 of 10"), std::string::npos) << outcome.err;
}

TEST_F(ReconstructCommand, MissingArgumentsAreNamed) {
  EXPECT_NE(run_b3dgs({"reconstruct"}).err.find("missing argument: INPUT"), std::string::npos);
  EXPECT_NE(run_b3dgs({"reconstruct", photos_}).err.find("missing argument: OUTPUT"), std::string::npos);
}

TEST_F(ReconstructCommand, CtrlCEndsColmapAndTheNextCallGoesOn) {
  const fs::path started = folder_ / "started";
  programs_.set_colmap_prelude("if [ $1 = mapper ]; then echo $$ > '" + started.string() + "'; exec sleep 600; fi");
  test::RunOptions options;
  options.signal = SIGINT;
  options.signal_when = [&] { return !test::read_bytes(started).empty(); };
  const Outcome stopped = run(options);
  EXPECT_EQ(stopped.exit_code, 130);
  EXPECT_NE(stopped.err.find("give the same command again"), std::string::npos) << stopped.err;
  EXPECT_EQ(kill(std::stoi(test::read_bytes(started)), 0), -1) << "colmap still runs";
  programs_.set_colmap_prelude("");
  programs_.forget_calls();
  EXPECT_EQ(run().exit_code, 0);
  ASSERT_EQ(programs_.calls().size(), 1u);
  EXPECT_EQ(programs_.calls()[0].rfind("mapper", 0), 0u);
}

}  // namespace
}  // namespace b3dgs
