// Fits camera centres to GPS positions, some of which may be wrong.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"

namespace b3dgs {

struct GpsFitInput {
  std::vector<std::array<double, 3>> centers;    // of the cameras, in any frame
  std::vector<std::array<double, 3>> positions;  // of the same photographs: m east, north, up
  bool has_heights = true;                       // otherwise, the third coordinates of the positions mean nothing
  std::optional<std::array<double, 3>> up;       // direction in the frame of the cameras, as the cameras show it
};

struct GpsFit {
  Similarity to_earth;
  bool is_level = false;          // up is that of the cameras, because the positions do not determine it
  std::vector<std::size_t> kept;  // positions that agree, ascending
  double median_residual = 0, largest_residual = 0;  // m, of the kept ones; without heights, horizontal
};

/// There must be a value.
double median(std::vector<double> values);

/// Least number of positions that are fitted.
inline constexpr std::size_t kLeastPositions = 4;

/// Finds the similarity with the least median distance between cameras and positions, so nearly half of the positions
/// may be wrong. Returns the similarity with the least sum of distances to the positions that agree with it. The random
/// numbers are always the same. If there are no heights, or the cameras stand nearly in a line, `up` decides which way
/// is up. Returns nothing if the positions do not determine the similarity or contradict the cameras, with the reason
/// in `why_not`.
std::optional<GpsFit> fit_to_gps(const GpsFitInput& input, std::string& why_not);

}  // namespace b3dgs
