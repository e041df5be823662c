// Numbers as text, in the terminal's output; those in pages are written by src/page/text.js.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "core/print.h"
#include "core/text.h"

namespace b3dgs {

/// "12.3 s", or "3.21 s" if `smallest`, the smallest of the times shown together, is below 10.
inline std::string format_seconds(double value, double smallest) {
  return print_to_string(smallest < 10 ? "%.2f s" : "%.1f s", value);
}

/// With three significant digits.
inline std::string format_figure(double value) {
  if (std::fabs(value) >= 1e7) return print_to_string("%.1f M", 1e-6 * value);
  if (std::fabs(value) >= 1000) return format_count(std::llround(value));
  if (value == std::round(value)) return print_to_string("%.0f", value);
  const int digits_before = static_cast<int>(std::floor(std::log10(std::fabs(value)))) + 1;
  return print_to_string("%.*f", std::clamp(3 - digits_before, 0, 6), value);
}

}  // namespace b3dgs
