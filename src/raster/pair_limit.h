// How many (tile, Gaussian) pairs a view may have. Slots have 32 bits: at over 100 bytes a pair (view_memory.h), a GPU
// that could hold more would need over 200 GB.
#pragma once

#include <cstdint>
#include <string>

#include "core/text.h"
#include "raster/args_check.h"

namespace b3dgs {

/// The Gaussian that touches most tiles of a view.
struct WidestGaussian {
  std::int64_t index = 0;
  std::int64_t n_tiles = 0;
};

inline bool has_too_many_pairs(std::int64_t n_pairs) {
  return n_pairs > kIndexMax;
}

/// Why such a view is refused, and what to do.
inline std::string too_many_pairs(std::int64_t n_pairs, const WidestGaussian& widest, std::int64_t n_tiles) {
  return "the view needs " + format_count(n_pairs) + " (tile, Gaussian) pairs, more than " + format_count(kIndexMax) +
         "; Gaussian " + std::to_string(widest.index) + " alone touches " + format_count(widest.n_tiles) + " of " +
         format_count(n_tiles) + " tiles; take smaller images (-r 2) or fewer Gaussians (--max_gaussians)";
}

}  // namespace b3dgs
