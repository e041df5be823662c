#include "app/reconstruct/program_log.h"

#include <cctype>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <utility>

#include "core/check.h"
#include "core/files/own_files.h"
#include "core/text.h"

namespace b3dgs {
namespace {

constexpr std::size_t kLinesKept = 60;

bool contains(const std::string& text, const char* part) {
  return lower_case(text).find(part) != std::string::npos;
}

/// Returns the message of "E20240131 10:11:12.123456 42 sfm.cc:264] failed to ..." without the prefix.
std::string without_prefix(const std::string& line) {
  const bool has_prefix =
      line.size() > 9 && std::strchr("IWEF", line[0]) != nullptr && line[1] >= '0' && line[1] <= '9';
  const std::size_t end = line.find("] ");
  return has_prefix && end != std::string::npos ? line.substr(end + 2) : line;
}

std::string trimmed(const std::string& line) {
  const std::size_t begin = line.find_first_not_of(" \t=-*"), end = line.find_last_not_of(" \t=-*");
  return begin == std::string::npos ? "" : line.substr(begin, end - begin + 1);
}

}  // namespace

std::string failure_line(const std::deque<std::string>& lines) {
  std::string last, last_error;
  for (const std::string& line : lines) {
    const std::string text = trimmed(without_prefix(line));
    if (text.empty()) continue;
    last = text;
    for (const char* word :
         {"error", "fail", "cannot", "could not", "invalid", "no such", "no space", "disk is full"}) {
      if (contains(text, word)) last_error = text;
    }
  }
  return last_error.empty() ? last : last_error;
}

ProgramLog::ProgramLog(std::filesystem::path file, const std::atomic<int>* stop) : path_(std::move(file)), stop_(stop) {
  make_way(path_);
  file_.open(path_, std::ios::app);
  check_written();
  if (OwnFiles* own = OwnFiles::of(path_)) own->add(path_, /*is_growing=*/true);
}

void ProgramLog::run(const std::vector<std::string>& argv, const OnChildLine& on_line, const OnChildBytes& on_bytes) {
  check_stop();
  std::string command = "\n$";
  for (const std::string& word : argv) command += " " + word;
  add(command);
  last_lines_.clear();
  const ChildResult result = run_program_lines(
      argv,
      [&](const std::string& line) {
        add(line);
        if (on_line) on_line(line);
      },
      stop_, on_bytes);
  check_stop();
  if (!result.succeeded()) fail(argv, result);
}

void ProgramLog::check_stop() const {
  if (stop_ != nullptr && *stop_ != 0) throw Stopped{};
}

void ProgramLog::check_written() const {
  if (!file_) io_error("cannot write to file: ", path_.string(), " (", std::strerror(errno), ")");
}

void ProgramLog::add(const std::string& line) {
  file_ << line << std::endl;
  check_written();
  last_lines_.push_back(line);
  if (last_lines_.size() > kLinesKept) last_lines_.pop_front();
}

void ProgramLog::fail(const std::vector<std::string>& argv, const ChildResult& result) {
  const std::string reason = failure_line(last_lines_);
  add("(" + describe(result) + ")");
  std::string program = std::filesystem::path(argv[0]).filename().string();
  if (program == "colmap" && argv.size() > 1) program += " " + argv[1];
  if (contains(reason, "disk is full") || contains(reason, "no space left")) {
    io_error(program, ": the disk is full: ", path_.parent_path().string(),
             "; free some space and give the same command again: it goes on from here");
  }
  if (result.signal == SIGKILL) {
    input_error(program, " was killed (signal 9), probably because memory ran out; give the same command again with ",
                "fewer --threads: it goes on from here (log: ", path_.string(), ")");
  }
  throw ProgramFailed(detail::one_line(detail::concat(program, " failed (", describe(result), ")",
                                                      reason.empty() ? "" : ": " + reason.substr(0, 300),
                                                      "; all of its output is in ", path_.string())),
                      lower_case(reason));
}

}  // namespace b3dgs
