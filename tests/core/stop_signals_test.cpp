#include "core/stop_signals.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "core/process/child_process.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

constexpr int kNotPermitted = 77, kStillRuns = 78;

int exit_code_of(pid_t process) {
  int status = 0;
  waitpid(process, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/// Returns the exit code of a process that is the first one of a container and runs `body`; kStillRuns if it returns.
template <class Body>
int exit_code_of_first_process(const Body& body) {
  const pid_t outer = fork();
  if (outer == 0) {
    if (unshare(CLONE_NEWPID) != 0) _exit(kNotPermitted);
    const pid_t first = fork();
    if (first == 0) {
      body();
      _exit(kStillRuns);
    }
    _exit(exit_code_of(first));
  }
  return exit_code_of(outer);
}

TEST(StopSignals, StayIgnoredIfTheyAre) {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    const auto before = std::signal(signal, SIG_IGN);
    handle_stop_signals([](int) {});
    EXPECT_EQ(std::signal(signal, SIG_IGN), SIG_IGN) << signal;
    end_by_stop_signals();
    EXPECT_EQ(std::signal(signal, before), SIG_IGN) << signal;
    std::signal(SIGINT, SIG_DFL), std::signal(SIGTERM, SIG_DFL), std::signal(SIGHUP, SIG_DFL);
  }
}

TEST(StopSignals, EndTheFirstProcessOfAContainer) {
  const test::TempDir folder;
  const std::filesystem::path file = folder / "temporary";
  test::write_bytes(file, "");
  const int code = exit_code_of_first_process([&] {
    const RemovedBySignal removed(file);
    end_by_signal(SIGTERM);
  });
  if (code == kNotPermitted) GTEST_SKIP() << "may not create process namespaces";
  EXPECT_EQ(code, 128 + SIGTERM);
  EXPECT_FALSE(std::filesystem::exists(file));
}

TEST(StopSignals, EndTheFirstProcessOfAContainerAfterItsChildren) {
  for (const bool is_handled : {false, true}) {
    const int code = exit_code_of_first_process([&] {
      if (is_handled) end_by_stop_signals();
      const EndingSignals signals;
      std::raise(SIGINT);
    });
    if (code == kNotPermitted) GTEST_SKIP() << "may not create process namespaces";
    EXPECT_EQ(code, 128 + SIGINT) << is_handled;
  }
}

}  // namespace
}  // namespace b3dgs
