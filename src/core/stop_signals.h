// Handles SIGINT, SIGTERM and SIGHUP, and removes the temporary files that they must not leave behind.
#pragma once

#include <filesystem>

namespace b3dgs {

/// Sets `handler` for SIGINT, SIGTERM and SIGHUP. System calls that wait then fail with EINTR instead of continuing. A
/// SIGHUP that is ignored, as after nohup, stays ignored.
void handle_stop_signals(void (*handler)(int signal));

/// Sets end_by_signal() as the handler of those of these signals that are not ignored.
void end_by_stop_signals();

/// A signal handler that removes all files and folders of RemovedBySignal objects, and ends the process by the signal or,
/// if that has no effect, with exit code 128 + signal.
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
