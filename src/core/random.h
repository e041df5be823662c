// Counter-based random numbers. Each is a function of (seed, stream, iteration, row). They do not depend on the order
// of calls, the number of threads or the device, and there is no state to save in a checkpoint.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Philox4x32-10 of Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3" (SC 2011).
B3DGS_HD std::array<std::uint32_t, 4> philox4x32(std::array<std::uint32_t, 4> counter,
                                                 std::array<std::uint32_t, 2> key) {
  constexpr std::uint64_t kMultiplier0 = 0xD2511F53u, kMultiplier1 = 0xCD9E8D57u;
  constexpr std::uint32_t kWeyl0 = 0x9E3779B9u, kWeyl1 = 0xBB67AE85u;
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t product0 = kMultiplier0 * counter[0], product1 = kMultiplier1 * counter[2];
    counter = {static_cast<std::uint32_t>(product1 >> 32) ^ counter[1] ^ key[0], static_cast<std::uint32_t>(product1),
               static_cast<std::uint32_t>(product0 >> 32) ^ counter[3] ^ key[1], static_cast<std::uint32_t>(product0)};
    key[0] += kWeyl0;
    key[1] += kWeyl1;
  }
  return counter;
}

/// Numbers of different streams are independent. Add streams only at the end: the value is part of every number.
enum class RandomStream : std::uint32_t {
  kViewOrder,
  kBackground,
  kSplit,
  kRelocation,
  kMeanNoise,
  kParents,
  kExposureJitter,
  kScenePoints,
  kSurfacePoints
};

struct RandomKey {
  std::int64_t seed = 0;
  RandomStream stream{};
  std::uint32_t iteration = 0;  // or another counter of the stream
};

/// Returns four independent 32-bit words for each row.
B3DGS_HD std::array<std::uint32_t, 4> random_bits(const RandomKey& key, std::uint64_t row) {
  const auto seed = static_cast<std::uint64_t>(key.seed);
  return philox4x32({static_cast<std::uint32_t>(row), static_cast<std::uint32_t>(row >> 32), key.iteration,
                     static_cast<std::uint32_t>(key.stream)},
                    {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)});
}

/// Returns numbers in [0, 1), multiples of 2^-24.
B3DGS_HD std::array<float, 4> random_uniform(const RandomKey& key, std::uint64_t row) {
  const std::array<std::uint32_t, 4> bits = random_bits(key, row);
  std::array<float, 4> values{};
  for (std::size_t i = 0; i < 4; ++i) values[i] = static_cast<float>(bits[i] >> 8) * 0x1p-24f;
  return values;
}

/// Returns numbers of mean 0, standard deviation 1 (Box-Muller, in double so that devices round to the same float).
B3DGS_HD std::array<float, 4> random_normal(const RandomKey& key, std::uint64_t row) {
  const std::array<std::uint32_t, 4> bits = random_bits(key, row);
  std::array<float, 4> values{};
  for (std::size_t i = 0; i < 4; i += 2) {
    const double radius = std::sqrt(-2 * std::log((bits[i] + 0.5) * 0x1p-32));
    const double angle = (2 * kPi) * (bits[i + 1] * 0x1p-32);
    values[i] = static_cast<float>(radius * std::cos(angle));
    values[i + 1] = static_cast<float>(radius * std::sin(angle));
  }
  return values;
}

}  // namespace b3dgs
