// Axes of charts: mapping values to pixels, choosing ticks, formatting numbers.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

enum class ScaleKind { kLinear, kLog };

/// Maps [low, high] to [from_px, to_px], linearly or logarithmically.
struct Scale {
  ScaleKind kind = ScaleKind::kLinear;
  double low = 0, high = 1;
  double from_px = 0, to_px = 1;

  double operator()(double value) const;
};

/// About `n` round numbers within [low, high]. Linear scale: multiples of 1, 2 or 5 times a power of ten, at least
/// `min_step` apart (1 for integers). Logarithmic scale: 1, 2 and 5 times powers of ten, or only powers of ten if the
/// range exceeds two decades.
std::vector<double> nice_ticks(ScaleKind kind, double low, double high, int n, double min_step = 0);

/// Widens [low, high] by a margin, and to 0 if `from_zero`; the result is never empty.
void pad_range(ScaleKind kind, bool from_zero, double& low, double& high);

/// "1,200", "0.035", "1.5 M": with enough digits to distinguish two numbers that differ by `step`.
std::string format_tick(double value, double step);

/// "12.3 s", or "3.21 s" if `smallest`, the smallest of the times shown together, is below 10.
std::string format_seconds(double value, double smallest);

/// With three significant digits.
std::string format_figure(double value);

}  // namespace b3dgs
