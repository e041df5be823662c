// Starts other programs, such as colmap and ffmpeg, without a shell.
#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "core/descriptor.h"

namespace b3dgs {

/// While one exists, SIGINT, SIGTERM and SIGHUP do not end this process. Signals that it ignored stay ignored, and its
/// own handlers are called as before. If there was no handler, or end_by_signal(), the signal is raised again at the
/// end of the last EndingSignals, so that the process ends as it would have. Any thread may create one.
class EndingSignals {
 public:
  EndingSignals();
  ~EndingSignals();
  EndingSignals(const EndingSignals&) = delete;
  EndingSignals& operator=(const EndingSignals&) = delete;

  /// Returns the last signal that came while any EndingSignals existed, or 0.
  int received() const;
};

/// How a program ended.
struct ChildResult {
  int exit_code = 0;
  int signal = 0;  // signal that ended it, 0 if it exited

  bool succeeded() const { return exit_code == 0 && signal == 0; }
};

/// Returns "exit code 3" or "ended by signal 9 (Killed)", for messages.
std::string describe(const ChildResult& result);

/// Called for each line of a child's standard output and standard error, which share one pipe, so their order is kept.
/// The line end ("\n", "\r\n" or "\r") is removed. Lines above 64 KiB come in parts.
using OnChildLine = std::function<void(const std::string& line)>;
/// Receives the standard output of a child if it is not text.
using OnChildBytes = std::function<void(const char* data, std::size_t bytes)>;

/// Starts the program argv[0], a path or a name in PATH, with empty standard input, and waits until it has ended. Does
/// not wait for processes that it leaves behind. With `on_bytes`, only the lines of standard error go to `on_line`.
///
/// If `*stop` becomes nonzero, or this process gets SIGINT, SIGTERM or SIGHUP, the program and its children get
/// SIGTERM, and SIGKILL after 5 s. ChildResult::signal is then not 0, even if the program exited. If this process has
/// no handler for the signal, it then ends too. A handler is called at once, and this function returns (EndingSignals).
/// If `on_line` throws, the program and its children are killed.
/// @throws InputError if there is no such program, IoError if it cannot be started
ChildResult run_program_lines(const std::vector<std::string>& argv, const OnChildLine& on_line,
                              const std::atomic<int>* stop = nullptr, const OnChildBytes& on_bytes = {});

/// A running program. If `has_input`, the caller writes its standard input, for example frames for ffmpeg.
class Child {
 public:
  /// Starts it, with the arguments, signals and errors of run_program_lines(). write() and finish() call the functions.
  explicit Child(const std::vector<std::string>& argv, OnChildLine on_line = {}, const std::atomic<int>* stop = nullptr,
                 OnChildBytes on_bytes = {}, bool has_input = true);
  /// Kills the program and its children, unless finish() has been called.
  ~Child();
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  /// Waits until the program has taken the bytes. Returns false if it has closed its input, has ended, or was told to
  /// end. Then finish() returns how it ended. SIGPIPE is never raised.
  bool write(const void* data, std::size_t bytes);

  /// Ends the program's input, passes on the rest of its output and waits until it has ended. Call it once.
  ChildResult finish();

 private:
  bool has_ended() const;
  void end_if_asked();
  void wait_for_io(bool wants_to_write);
  bool read_output();
  void add_text(const char* text, std::size_t bytes);
  void end_line();
  ChildResult reap();

  EndingSignals signals_;  // first, so that a signal between this and the start of the program is not lost
  const OnChildLine on_line_;
  const OnChildBytes on_bytes_;
  const std::atomic<int>* const stop_;
  Descriptor text_, data_, input_;
  std::string line_;           // beginning of the current line
  bool after_return_ = false;  // the last character was "\r"
  pid_t pid_ = -1;
  bool is_reaped_ = false, is_ending_ = false;
  std::chrono::steady_clock::time_point kill_at_{};
};

/// Returns the full path of a program: `name` itself if it has a slash, else the first in PATH. Empty if there is none.
std::string find_program(const std::string& name);

}  // namespace b3dgs
