// Numeric derivatives in double precision, to check analytic gradients.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <vector>

namespace b3dgs::test {

/// Returns the gradient of value(x) at `x` by central differences at two step sizes with Richardson extrapolation. The
/// error is of fourth order in the step, about 1e-10 relative for smooth functions of order 1. `step` is relative for
/// entries above 1.
template <class Function>
std::vector<double> numeric_gradient(Function&& value, std::vector<double> x, double step = 1e-3) {
  std::vector<double> gradient(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double center = x[i];
    const double h = step * std::max(1.0, std::abs(center));
    const auto slope = [&](double width) {
      x[i] = center + width;
      const double above = value(x);
      x[i] = center - width;
      const double below = value(x);
      x[i] = center;
      return (above - below) / (2.0 * width);
    };
    gradient[i] = (4.0 * slope(0.5 * h) - slope(h)) / 3.0;
  }
  return gradient;
}

/// Returns whether all entries of two gradients agree within `tolerance` times the larger of their norms.
inline testing::AssertionResult gradients_agree(const std::vector<double>& analytic, const std::vector<double>& numeric,
                                                double tolerance = 1e-6) {
  if (analytic.size() != numeric.size()) {
    return testing::AssertionFailure() << analytic.size() << " entries against " << numeric.size();
  }
  double analytic_square = 0, numeric_square = 0;
  for (std::size_t i = 0; i < numeric.size(); ++i) {
    analytic_square += analytic[i] * analytic[i];
    numeric_square += numeric[i] * numeric[i];
  }
  const double allowed = tolerance * std::sqrt(std::max(analytic_square, numeric_square));
  std::ostringstream faults;
  for (std::size_t i = 0; i < numeric.size(); ++i) {
    if (!(std::abs(analytic[i] - numeric[i]) <= allowed)) {
      faults << "\n  entry " << i << ": analytic " << analytic[i] << ", numeric " << numeric[i];
    }
  }
  if (faults.str().empty()) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "gradients differ by more than " << allowed << faults.str();
}

}  // namespace b3dgs::test
