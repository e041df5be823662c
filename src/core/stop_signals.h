// Handles SIGINT, SIGTERM and SIGHUP, and removes the temporary files that they must not leave behind.
#pragma once

#include <filesystem>

namespace b3dgs {

/// Lets `handler` handle SIGINT, SIGTERM and SIGHUP. System calls that wait then fail with EINTR instead of going on.
/// Signals that are ignored stay ignored: SIGHUP after nohup, and SIGINT of a program that a script runs with `&`.
void handle_stop_signals(void (*handler)(int signal));

/// Lets end_by_signal() handle them.
void end_by_stop_signals();

/// A signal handler that removes all files and folders of RemovedBySignal objects, and ends the process by the signal
/// or, if that has no effect, with exit code 128 + signal.
extern "C" void end_by_signal(int signal);

/// While it exists, end_by_signal() removes a file, or a folder with its content.
class RemovedBySignal {
 public:
  explicit RemovedBySignal(const std::filesystem::path& path);
  ~RemovedBySignal();
  RemovedBySignal(const RemovedBySignal&) = delete;
  RemovedBySignal& operator=(const RemovedBySignal&) = delete;

 private:
  int slot_ = -1;
};

}  // namespace b3dgs
