// Reads the fields of one line of a text file in order.
#pragma once

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>

#include "core/check.h"

namespace b3dgs {

/// Fields are separated by blanks, tabs and commas, as in COLMAP's text files.
class TextFields {
 public:
  explicit TextFields(std::string_view line) : rest_(line) { skip_separators(); }

  bool empty() const { return rest_.empty(); }

  /// The next field; empty at the end of the line.
  std::string_view word() {
    const std::size_t end = std::min(rest_.find_first_of(kSeparators), rest_.size());
    const std::string_view field = rest_.substr(0, end);
    rest_.remove_prefix(end);
    skip_separators();
    return field;
  }

  /// The rest of the line without trailing blanks, for names, which may contain blanks and commas.
  std::string_view rest() const {
    const std::size_t last = rest_.find_last_not_of(" \t\r");
    return last == std::string_view::npos ? std::string_view() : rest_.substr(0, last + 1);
  }

  /// The next field as a number. @throws InputError naming place() and `what` if it is not one
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
