// Runs the built b3dgs program as a user does: as a process of its own.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace b3dgs::test {

struct Outcome {
  int exit_code = -1;  // 128 + signal if a signal ended it
  std::string out, err;
};

struct RunOptions {
  std::filesystem::path folder;       // working folder; empty: that of the test
  long long file_size_limit = 0;      // bytes; a write beyond it fails as on a full disk; 0: none
  std::function<bool()> signal_when;  // polled while the program runs; `signal` is sent once it is true
  int signal = 0;
  int n_signals = 1;  // one a millisecond
};

/// Runs `b3dgs WORDS...` to its end. Fails the test, and kills the program, after two minutes.
Outcome run_b3dgs(const std::vector<std::string>& words, const RunOptions& options = {});

}  // namespace b3dgs::test
