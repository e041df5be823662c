// The log of the programs that a reconstruction runs, SCENE/reconstruct.log.
#pragma once

#include <atomic>
#include <deque>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/process/child_process.h"

namespace b3dgs {

/// Thrown if a program was ended because `stop` requested it. Not an error of the user.
struct Stopped {};

/// Thrown if a program that this one runs has failed.
struct ProgramFailed : InputError {
  ProgramFailed(const std::string& message, std::string why) : InputError(message), reason(std::move(why)) {}
  std::string reason;  // its failure_line(), in lower case
};

class ProgramLog {
 public:
  /// Appends to the file, which belongs to the program from then on. @throws IoError
  ProgramLog(std::filesystem::path file, const std::atomic<int>* stop);

  /// Runs a program with its output in the log. With `on_bytes`, which receives standard output, the log has only
  /// standard error. @throws ProgramFailed: program, reason, log; InputError if it was killed; IoError if the disk is
  /// full; Stopped; InputError and IoError of run_program_lines()
  void run(const std::vector<std::string>& argv, const OnChildLine& on_line = {}, const OnChildBytes& on_bytes = {});

  /// @throws Stopped if `stop` requests it
  void check_stop() const;

 private:
  void check_written() const;
  void add(const std::string& line);
  [[noreturn]] void fail(const std::vector<std::string>& argv, const ChildResult& result);

  std::filesystem::path path_;
  const std::atomic<int>* stop_;
  std::ofstream file_;
  std::deque<std::string> last_lines_;
};

/// Returns the most informative of a failed program's last lines: the last one that mentions an error, or the last one
/// that is not empty, without the prefix of a logging library. Returns "" if there is none.
std::string failure_line(const std::deque<std::string>& lines);

}  // namespace b3dgs
