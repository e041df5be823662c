// What a fuzz target is: one function that gives bytes to a reader. libfuzzer_main.cpp drives it with libFuzzer's
// bytes, run_files_main.cpp with files.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/check.h"

namespace b3dgs::fuzz {

/// Gives `bytes` to the reader under test, and holds what it returns against what the reader promises.
/// @throws InputError if the reader refuses them. Any other exception is a fault of the reader.
void read_input(std::string_view bytes);

/// Whether the reader took the bytes. @throws LogicError if it refused them in several lines or without a word
inline bool takes_input(std::string_view bytes) {
  try {
    read_input(bytes);
    return true;
  } catch (const InputError& error) {
    const std::string message = error.what();
    B3DGS_CHECK(!message.empty() && message.find('\n') == std::string::npos, "not one line: ", message);
    return false;
  }
}

/// Several files in one input stand between these.
inline constexpr std::string_view kFileSeparator = "<<next file>>";

/// The first `n` files of an input; those that are not there are empty.
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
