// The program b3dgs: commands that work without the engine, and how its threads wait.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::run_b3dgs;
using test::run_shell;

TEST(Program, CommandsThatNeedNoTorchWorkWithoutTheEngine) {
  const test::TempDir folder;
  fs::copy(B3DGS_PROGRAM, folder / "b3dgs");
  const std::string program = (folder / "b3dgs").string(), scene = (folder / "scene").string();
  const auto expect = [&](const std::string& words, int code, const char* text) {
    EXPECT_EQ(run_shell(folder.path(), program + " " + words), code) << words;
    const std::string out = test::read_bytes(folder / "out");
    EXPECT_NE(out.find(text), std::string::npos) << words << ": " << out;
  };
  expect("--version", 0, "b3dgs ");
  expect("--help", 0, "Usage: b3dgs COMMAND");
  expect("synth orbit " + scene + " --views 4 --width 48 --height 36 --points 200 --quiet", 0,
         "4 images of 48 x 36 px");
  expect("info " + scene, 0, "4");
  expect("info " + scene + "/truth.ply", 0, "Gaussians");
  expect("help report", 0, "Rewrite report.html");
  expect("report " + scene, 2, "error: neither a model folder nor a comparison");
  expect("trian", 2, "error: unknown command \"trian\"; did you mean train?");
  expect("eval", 1, "error: cannot load the engine (libb3dgs-engine.so: cannot open shared object file");
}

TEST(Program, ThreadsSleepWhileTheyWaitUnlessTheUserSaysOtherwise) {
  setenv("OMP_DISPLAY_ENV", "true", 1);
  const std::string by_default = run_b3dgs({"train", "--help"}).err;
  setenv("OMP_WAIT_POLICY", "active", 1);
  const std::string overridden = run_b3dgs({"train", "--help"}).err;
  unsetenv("OMP_WAIT_POLICY");
  unsetenv("OMP_DISPLAY_ENV");
  EXPECT_NE(by_default.find("OMP_WAIT_POLICY = 'PASSIVE'"), std::string::npos) << by_default;
  EXPECT_NE(overridden.find("OMP_WAIT_POLICY = 'ACTIVE'"), std::string::npos) << overridden;
}

}  // namespace
}  // namespace b3dgs
