// std::printf into a string, for short numbers in messages and reports.
#pragma once

#include <cstdio>
#include <string>

namespace b3dgs {

/// Cuts the text after 199 characters.
template <class... Args>
std::string print_to_string(const char* format, Args... args) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, format, args...);
  return buffer;
}

}  // namespace b3dgs
