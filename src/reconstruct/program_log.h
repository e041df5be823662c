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

/// A program was ended because `stop` asked for it. Not an error of the user.
struct Stopped {};

/// A program that this one runs has failed.
struct ProgramFailed : InputError {
  ProgramFailed(const std::string& message, std::string why) : InputError(message), reason(std::move(why)) {}
  std::string reason;  // its failure_line(), in lower case
};

class ProgramLog {
 public:
  /// Appends to the file, which is the program's own from then on. @throws IoError
  ProgramLog(std::filesystem::path file, const std::atomic<int>* stop);

  /// Runs a program with its output in the log; with `on_bytes`, which takes standard output, only that of standard
  /// error. @throws ProgramFailed: program, reason, log; InputError if it was killed; IoError if the disk is full;
  /// Stopped; InputError and IoError of run_program_lines()
  void run(const std::vector<std::string>& argv, const OnChildLine& on_line = {}, const OnChildBytes& on_bytes = {});

  /// @throws Stopped if `stop` asks for it
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

/// The line among a failed program's last lines that says most about why: the last one that speaks of an error, or the
/// last one that is not empty; without the prefix of a logging library. Empty if there is none.
std::string failure_line(const std::deque<std::string>& lines);

}  // namespace b3dgs
