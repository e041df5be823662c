// scripts/setup_gpu.sh on machines with missing parts, and installation of the program.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Simulates a machine with scripts that print the output of nvidia-smi and nvcc.
class SetupGpu : public testing::Test {
 protected:
  void add_program(const std::string& name, const std::string& answer) {
    const fs::path path = temp / "bin" / name;
    test::write_bytes(path, "#!/bin/sh\ncat <<'ANSWER'\n" + answer + "\nANSWER\n");
    fs::permissions(path, fs::perms::owner_all);
  }
  void add_gpu(const std::string& capability) { add_program("nvidia-smi", "NVIDIA Test GPU, 550.54, " + capability); }
  void add_nvcc() { add_program("nvcc", "Cuda compilation tools, release 12.6, V12.6.20"); }

  /// Runs setup_gpu.sh and returns its exit code. Its output is in `output`.
  int run(const std::string& arguments) {
    const std::string folder = temp.path().string();
    const std::string command = "cd '" + folder + "' && PATH='" + folder + "/bin:/usr/bin:/bin' HOME='" + folder +
                                "' CUDA_HOME='" + folder + "/cuda' LIBTORCH= '" B3DGS_SOURCE "/scripts/setup_gpu.sh' " +
                                arguments + " > output 2>&1";
    const int status = std::system(command.c_str());
    output = test::read_bytes(temp / "output");
    return WEXITSTATUS(status);
  }

  const test::TempDir temp;
  std::string output;
};

TEST_F(SetupGpu, ReportsWhatIsMissing) {
  add_program("nvcc", "Cuda compilation tools, release 12.6, V12.6.20");
  add_program("nvidia-smi", "");
  EXPECT_EQ(run("--check --libtorch '" + (temp / "none").string() + "'"), 1);
  EXPECT_NE(output.find("missing  GPU"), std::string::npos) << output;
  EXPECT_NE(output.find("CUDA 12.6"), std::string::npos) << output;
  EXPECT_NE(output.find("missing  LibTorch   none with CUDA in: " + (temp / "none").string()), std::string::npos)
      << output;
  EXPECT_NE(output.find("setup_gpu.sh: error: 2 of 3 are missing"), std::string::npos) << output;
}

TEST_F(SetupGpu, RejectsAGpuThatIsTooOld) {
  add_gpu("6.1");
  add_nvcc();
  EXPECT_EQ(run("--check"), 1);
  EXPECT_NE(output.find("compute capability 6.1; 7.5 (Turing, 2018) or later is needed"), std::string::npos) << output;
}

TEST_F(SetupGpu, FindsWhatIsInstalled) {
  add_gpu("8.6");
  add_nvcc();
  test::write_bytes(temp / "libtorch/lib/libtorch_cuda.so", "");
  EXPECT_EQ(run("--check"), 0) << output;
  EXPECT_NE(output.find("NVIDIA Test GPU, 550.54, compute capability 8.6"), std::string::npos) << output;
  EXPECT_NE(output.find(fs::canonical(temp / "libtorch").string()), std::string::npos) << output;
}

TEST_F(SetupGpu, RejectsUnknownOptions) {
  EXPECT_EQ(run("--chek"), 2);
  EXPECT_NE(output.find("unknown option: --chek"), std::string::npos) << output;
}

TEST(Install, TheInstalledProgramRuns) {
  const test::TempDir temp;
  const std::string command = "cmake --install '" B3DGS_BUILD "' --prefix '" + (temp / "here").string() + "' > '" +
                              (temp / "log").string() + "' 2>&1";
  ASSERT_EQ(std::system(command.c_str()), 0) << test::read_bytes(temp / "log");
  for (const char* name : {"bin/b3dgs", "lib/b3dgs/libb3dgs-engine.so"})
    EXPECT_TRUE(fs::exists(temp / "here" / name)) << name;
  const std::string program = (temp / "here/bin/b3dgs").string();
  EXPECT_EQ(std::system(("'" + program + "' train --help > '" + (temp / "help").string() + "'").c_str()), 0);
  EXPECT_NE(test::read_bytes(temp / "help").find("--iterations"), std::string::npos);
}

}  // namespace
}  // namespace b3dgs
