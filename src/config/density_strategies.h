// The names of the density strategies, for the command line. What a strategy does is in src/train/density; the table
// there has the same rows in the same order.
#pragma once

#include <array>
#include <string_view>

namespace b3dgs {

inline constexpr std::string_view kDefaultStrategy = "default";  // density control of the original 3DGS

inline constexpr std::array<std::string_view, 3> kDensityStrategies{kDefaultStrategy, "mcmc", "budget"};

}  // namespace b3dgs
