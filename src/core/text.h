// Counts, sizes and durations as text; lower case.
#pragma once

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/print.h"

namespace b3dgs {

/// "1,234,567".
inline std::string format_count(std::int64_t n) {
  std::string text = std::to_string(n);
  for (std::ptrdiff_t at = static_cast<std::ptrdiff_t>(text.size()) - 3; at > (n < 0 ? 1 : 0); at -= 3) {
    text.insert(static_cast<std::size_t>(at), ",");
  }
  return text;
}

/// "1.23 GB", "45.6 MB" or "7.8 kB", with decimal units: 1 GB is 10^9 bytes.
inline std::string format_bytes(std::int64_t bytes) {
  const auto value = static_cast<double>(bytes);
  if (bytes >= 1000000000) return print_to_string("%.2f GB", 1e-9 * value);
  if (bytes >= 1000000) return print_to_string("%.1f MB", 1e-6 * value);
  return print_to_string("%.1f kB", 1e-3 * value);
}

/// "1:02:03" or "2:03".
inline std::string format_duration(double seconds) {
  const long long total = std::llround(std::clamp(seconds, 0.0, 3.6e8));
  const int hours = static_cast<int>(total / 3600), minutes = static_cast<int>(total / 60 % 60);
  const int rest = static_cast<int>(total % 60);
  return hours > 0 ? print_to_string("%d:%02d:%02d", hours, minutes, rest) : print_to_string("%d:%02d", minutes, rest);
}

/// Of ASCII letters.
inline std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

}  // namespace b3dgs
