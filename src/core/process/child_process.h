// Starts other programs, such as colmap and ffmpeg, without a shell.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace b3dgs {

/// How a program ended.
struct ChildResult {
  int exit_code = 0;
  int signal = 0;  // the signal that ended it; 0 if it exited

  bool succeeded() const { return exit_code == 0 && signal == 0; }
};

/// "exit code 3" or "ended by signal 9 (Killed)", for messages.
std::string describe(const ChildResult& result);

/// Is called for each line of a child's standard output and standard error, which come through one pipe in the order
/// in which they were written. Without the line's end: "\n", "\r\n" or "\r". Lines above 64 KiB come in parts.
using OnChildLine = std::function<void(const std::string& line)>;
/// Takes what a child writes to its standard output, where that is not text.
using OnChildBytes = std::function<void(const char* data, std::size_t bytes)>;

/// Starts the program argv[0], a path or a name in PATH, with empty standard input, and waits until it has ended.
/// Processes that it leaves behind are not waited for. With `on_bytes`, only the lines of standard error go to
/// `on_line`.
///
/// If `*stop` becomes other than 0, or this process gets SIGINT, SIGTERM or SIGHUP, the program and its children get
/// SIGTERM, and SIGKILL after 5 s; ChildResult::signal is then not 0, even if the program exited. A signal for which
/// this process has no handler ends this process thereafter; a handler is called at once, and this function returns
/// (EndingSignals). If `on_line` throws, the program and its children are killed.
/// @throws InputError if there is no such program, IoError if it cannot be started
ChildResult run_program_lines(const std::vector<std::string>& argv, const OnChildLine& on_line,
                              const std::atomic<int>* stop = nullptr, const OnChildBytes& on_bytes = {});

class Child;

/// A program whose standard input the caller writes, for example frames for ffmpeg.
class ChildInput {
 public:
  /// Starts it; arguments, signals and errors as for run_program_lines(). `on_line` is called from write() and
  /// finish().
  explicit ChildInput(const std::vector<std::string>& argv, const OnChildLine& on_line = {},
                      const std::atomic<int>* stop = nullptr);
  /// Kills the program and its children, unless finish() has been called.
  ~ChildInput();
  ChildInput(const ChildInput&) = delete;
  ChildInput& operator=(const ChildInput&) = delete;

  /// Waits until the program has taken the bytes. False if it has closed its input, has ended, or was told to end:
  /// finish() then says how it ended. SIGPIPE is never raised.
  bool write(const void* data, std::size_t bytes);

  /// Ends the program's input, passes on the rest of its output and waits until it has ended. Call it once.
  ChildResult finish();

 private:
  std::unique_ptr<Child> child_;
};

/// Full path of an executable program: `name` itself if it has a slash, else the first in PATH. Empty if there is none.
std::string find_program(const std::string& name);

}  // namespace b3dgs
