// Options whose values are names: an enumeration for each, and names_of() with the names of its values in their order.
#pragma once

#include <array>

#include "raster/args.h"

namespace b3dgs {

/// The values of --strategy. kDefault is the density control of the original 3DGS.
enum class Strategy { kDefault, kMcmc, kBudget };
constexpr std::array<const char*, 3> names_of(Strategy) {
  return {"default", "mcmc", "budget"};
}

/// The target at pixels that a mask leaves out.
enum class MaskMode {
  kIgnore,   // none: they are not part of the loss
  kSegment,  // empty space
};
constexpr std::array<const char*, 2> names_of(MaskMode) {
  return {"ignore", "segment"};
}

constexpr std::array<const char*, 2> names_of(Culling) {
  return {"ellipse", "square"};
}

}  // namespace b3dgs
