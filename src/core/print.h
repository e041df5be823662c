// std::printf into a string, for the short figures of messages and reports.
#pragma once

#include <cstdio>
#include <string>

namespace b3dgs {

/// What is longer than 199 characters is cut.
template <class... Args>
std::string print_to_string(const char* format, Args... args) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, format, args...);
  return buffer;
}

}  // namespace b3dgs
