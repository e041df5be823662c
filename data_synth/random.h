// Random numbers that do not depend on the standard library. C++ specifies the output of std::mt19937_64 exactly, but
// not that of the standard distributions.
#pragma once

#include <cmath>
#include <cstdint>
#include <random>

#include "core/vec.h"

namespace b3dgs {

class Random {
 public:
  explicit Random(std::int64_t seed) : engine_(static_cast<std::uint64_t>(seed)) {}

  /// Returns a number in [0, 1).
  double uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// Returns a number with mean 0 and standard deviation 1 (Box-Muller).
  double normal() {
    const double radius = std::sqrt(-2 * std::log(1 - uniform()));
    return radius * std::cos((2 * kPi) * uniform());
  }
  double exponential(double mean) { return -mean * std::log(1 - uniform()); }

 private:
  std::mt19937_64 engine_;
};

}  // namespace b3dgs
