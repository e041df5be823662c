// Runs the b3dgs program as a separate process.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace b3dgs::test {

struct Outcome {
  int exit_code = -1;  // 128 + signal if killed by a signal
  std::string out, err;
};

struct RunOptions {
  std::string program = B3DGS_PROGRAM;
  std::filesystem::path folder;       // working folder, empty for the current one
  long long file_size_limit = 0;      // bytes, 0 for no limit; writes beyond it fail as on a full disk
  bool obeys_permissions = false;     // obey file permissions, even if root runs the tests
  std::function<bool()> signal_when;  // polled while the program runs; sends `signal` once it is true
  int signal = 0;
  int n_signals = 1;  // one per millisecond
};

/// Runs `b3dgs WORDS...` and waits for it. After two minutes, kills the program and fails the test.
Outcome run_b3dgs(const std::vector<std::string>& words, const RunOptions& options = {});

/// Runs a shell command and returns its exit code. Its output is in `folder`/out.
int run_shell(const std::filesystem::path& folder, const std::string& command);

}  // namespace b3dgs::test
