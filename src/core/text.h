// Text of messages, reports and commands, and the fields of a line of text.
#pragma once

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <sstream>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "core/check.h"

namespace b3dgs {

/// std::printf into a string.
template <class... Args>
std::string print_to_string(const char* format, Args... args) {
  std::string text(static_cast<std::size_t>(std::snprintf(nullptr, 0, format, args...)), '\0');
  std::snprintf(text.data(), text.size() + 1, format, args...);
  return text;
}

// Counts, sizes and durations as text, in lower case.

/// Returns "1,234,567".
inline std::string format_count(std::int64_t n) {
  std::string text = std::to_string(n);
  for (std::ptrdiff_t at = static_cast<std::ptrdiff_t>(text.size()) - 3; at > (n < 0 ? 1 : 0); at -= 3) {
    text.insert(static_cast<std::size_t>(at), ",");
  }
  return text;
}

/// Returns "1.23 GB", "45.6 MB" or "7.8 kB", with decimal units: 1 GB is 10^9 bytes.
inline std::string format_bytes(std::int64_t bytes) {
  const auto value = static_cast<double>(bytes);
  if (bytes >= 1000000000) return print_to_string("%.2f GB", 1e-9 * value);
  if (bytes >= 1000000) return print_to_string("%.1f MB", 1e-6 * value);
  return print_to_string("%.1f kB", 1e-3 * value);
}

/// Returns "1:02:03" or "2:03".
inline std::string format_duration(double seconds) {
  const long long total = std::llround(std::clamp(seconds, 0.0, 3.6e8));
  const int hours = static_cast<int>(total / 3600), minutes = static_cast<int>(total / 60 % 60);
  const int rest = static_cast<int>(total % 60);
  return hours > 0 ? print_to_string("%d:%02d:%02d", hours, minutes, rest) : print_to_string("%d:%02d", minutes, rest);
}

/// Returns "1, 2, 3".
template <class Item>
std::string list_text(const std::vector<Item>& items, const char* separator = ", ") {
  std::ostringstream text;
  for (std::size_t i = 0; i < items.size(); ++i) text << (i == 0 ? "" : separator) << items[i];
  return text.str();
}

/// Converts ASCII letters to lower case.
inline std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

/// Returns the first line of an error's text, because LibTorch appends a stack trace.
inline std::string first_line(const std::string& text) {
  return text.substr(0, text.find('\n'));
}

// Words of commands that are printed to be copied into a shell.

/// Returns the word such that a POSIX shell reads it back: unchanged if it has no special characters, otherwise in
/// single quotes. Before the call, write a name that begins with "-" as "./-name".
inline std::string shell_quote(const std::string& word) {
  constexpr const char* kPlain = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-+./:,=@%";
  if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
  std::string quoted = "'";
  for (const char c : word) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quoted + "'";
}

// Reads the fields of one line of a text file in order.

/// Fields are separated by blanks, tabs and commas, as in COLMAP's text files.
class TextFields {
 public:
  explicit TextFields(std::string_view line) : rest_(line) { skip_separators(); }

  bool empty() const { return rest_.empty(); }

  /// Returns the next field, empty at the end of the line.
  std::string_view word() {
    const std::size_t end = std::min(rest_.find_first_of(kSeparators), rest_.size());
    const std::string_view field = rest_.substr(0, end);
    rest_.remove_prefix(end);
    skip_separators();
    return field;
  }

  /// Returns the rest of the line without trailing blanks, for names, which may contain blanks and commas.
  std::string_view rest() const {
    const std::size_t last = rest_.find_last_not_of(" \t\r");
    return last == std::string_view::npos ? std::string_view() : rest_.substr(0, last + 1);
  }

  /// Returns the next field as a number. @throws InputError naming place() and `what` if it is not one
  template <class T, class Place>
  T number(const char* what, const Place& place) {
    std::string_view field = word();
    if (field.size() > 1 && field[0] == '+') field.remove_prefix(1);  // from_chars rejects a plus sign
    T value{};
    const auto result = std::from_chars(field.data(), field.data() + field.size(), value);
    if (result.ec != std::errc() || result.ptr != field.data() + field.size() || field.empty()) {
      input_error(place(), ": expected ", what, std::is_integral_v<T> ? " (a whole number)" : " (a number)", ", found ",
                  field.empty() ? std::string("the end of the line") : '"' + std::string(field.substr(0, 40)) + '"');
    }
    return value;
  }

 private:
  static constexpr const char* kSeparators = " \t\r,";

  void skip_separators() {
    const std::size_t begin = rest_.find_first_not_of(kSeparators);
    rest_.remove_prefix(begin == std::string_view::npos ? rest_.size() : begin);
  }

  std::string_view rest_;
};

}  // namespace b3dgs
