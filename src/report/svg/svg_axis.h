// Scales and ticks: numbers to pixels, and which numbers to print.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

enum class ScaleKind { kLinear, kLog };

/// Maps [low, high] to [from_px, to_px], linearly or by the logarithm.
struct Scale {
  ScaleKind kind = ScaleKind::kLinear;
  double low = 0, high = 1;
  double from_px = 0, to_px = 1;

  double operator()(double value) const;
};

/// Round numbers within [low, high], about `n` of them: steps of 1, 2 or 5 times a power of ten; powers of ten on a
/// logarithmic scale of more than two decades. On a linear one they are at least `least_step` apart: 1 for what is
/// counted.
std::vector<double> nice_ticks(ScaleKind kind, double low, double high, int n, double least_step = 0);

/// The range to show for values in [low, high]: with room, from 0 where `from_zero`, never empty.
void pad_range(ScaleKind kind, bool from_zero, double& low, double& high);

/// "1,200", "0.035", "1.5 M": as many digits as tell two numbers `step` apart.
std::string format_tick(double value, double step);

/// "12.3 s", or "3.21 s" where `smallest` of the times beside it is below 10.
std::string format_seconds(double value, double smallest);

/// A figure by itself, in three significant digits.
std::string format_figure(double value);

}  // namespace b3dgs
