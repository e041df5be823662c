// A fuzz target is one function, read_input(), that passes bytes to a reader. main/libfuzzer.cpp calls it with
// libFuzzer's inputs, main/run_files.cpp with files.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/check.h"

namespace b3dgs::fuzz {

/// Passes `bytes` to the reader under test and checks what it returns against its documentation. Defined by each
/// target.
/// @throws InputError if the reader rejects the bytes. Any other exception is a bug
void read_input(std::string_view bytes);

/// Returns whether the reader accepts the bytes. @throws LogicError if its error is empty or longer than one line
inline bool accepts_input(std::string_view bytes) {
  try {
    read_input(bytes);
    return true;
  } catch (const InputError& error) {
    const std::string message = error.what();
    B3DGS_CHECK(!message.empty() && message.find('\n') == std::string::npos,
                "expected an error of one line, found: ", message);
    return false;
  }
}

/// Separates the files of an input that consists of several.
inline constexpr std::string_view kFileSeparator = "<<next file>>";

/// Returns the first `n` files of an input. Missing ones are empty.
inline std::vector<std::string_view> split_files(std::string_view bytes, std::size_t n) {
  std::vector<std::string_view> files;
  while (files.size() + 1 < n) {
    const std::size_t end = bytes.find(kFileSeparator);
    files.push_back(bytes.substr(0, end));
    bytes = end == std::string_view::npos ? std::string_view() : bytes.substr(end + kFileSeparator.size());
  }
  files.push_back(bytes);
  return files;
}

}  // namespace b3dgs::fuzz
