// Limit on the number of (tile, Gaussian) pairs of one view. Slots are 32-bit; at over 100 bytes per pair
// (view_memory.h), more pairs would need over 200 GB of GPU memory.
#pragma once

#include <cstdint>
#include <string>

#include "core/text.h"
#include "raster/args_check.h"

namespace b3dgs {

/// The Gaussian, or row of splats, that touches the most tiles of a view.
struct WidestGaussian {
  std::int64_t index = 0;
  std::int64_t n_tiles = 0;
};

inline bool has_too_many_pairs(std::int64_t n_pairs) {
  return n_pairs > kIndexMax;
}

/// The limit of a view, and what its splats have the index of.
struct PairLimit {
  std::int64_t n_pairs = kIndexMax;
  const char* indexed = "Gaussian";
};

/// Error message for a view with too many pairs. `what` is what `widest` has the index of.
inline std::string too_many_pairs(std::int64_t n_pairs, const WidestGaussian& widest, std::int64_t n_tiles,
                                  const char* what = "Gaussian") {
  return "the view needs " + format_count(n_pairs) + " (tile, Gaussian) pairs, more than " + format_count(kIndexMax) +
         "; " + what + " " + std::to_string(widest.index) + " alone touches " + format_count(widest.n_tiles) + " of " +
         format_count(n_tiles) + " tiles; use smaller images (-r 2) or fewer Gaussians (--max_gaussians)";
}

}  // namespace b3dgs
