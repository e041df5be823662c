// What SIGINT, SIGTERM and SIGHUP do to this process, and the temporary files that they must not leave behind.
#pragma once

#include <filesystem>

namespace b3dgs {

/// Lets `handler` handle SIGINT, SIGTERM and SIGHUP. System calls that wait then fail with EINTR instead of going on.
/// A SIGHUP that is ignored, as after nohup, stays ignored.
void handle_stop_signals(void (*handler)(int signal));

/// Handles each of these signals that is not ignored by end_by_signal().
void end_by_stop_signals();

/// Removes all files and folders that a RemovedBySignal names, and ends the process by the signal. A signal handler.
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
