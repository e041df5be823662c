// The output of a program, as lines.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <utility>

namespace b3dgs {

/// Calls a function for each line, without its end: "\n", "\r\n" or "\r". Lines above 64 KiB come in parts.
class LineSplitter {
 public:
  explicit LineSplitter(std::function<void(const std::string& line)> on_line) : on_line_(std::move(on_line)) {}

  void add(const char* text, std::size_t bytes) {
    for (std::size_t i = 0; i < bytes; ++i) {
      const char c = text[i];
      const bool is_second_half = c == '\n' && after_return_;
      after_return_ = c == '\r';
      if (is_second_half) continue;
      if (c == '\n' || c == '\r') {
        end_line();
      } else {
        line_ += c;
        if (line_.size() >= kMaxLine) end_line();
      }
    }
  }

  /// Passes on a last line that has no end.
  void finish() {
    if (!line_.empty()) end_line();
  }

 private:
  static constexpr std::size_t kMaxLine = 1 << 16;

  void end_line() {
    if (on_line_) on_line_(line_);
    line_.clear();
  }

  std::function<void(const std::string& line)> on_line_;
  std::string line_;
  bool after_return_ = false;
};

}  // namespace b3dgs
