// Scale and offset that turn the values of an inverse depth map, which a network estimates up to both, into inverse
// depths of the scene, from its sparse points.
#pragma once

#include <optional>
#include <vector>

namespace b3dgs {

/// 1 / z = scale * value + offset, in 1 / world units.
struct DepthAlignment {
  double scale = 0, offset = 0;
};

inline constexpr std::size_t kMinAlignmentPoints = 11;
// Scales of maps that are used, as multiples of the median of all scales.
inline constexpr double kMinScaleRatio = 0.2, kMaxScaleRatio = 5;

/// From the map's value at each point that the view sees, and the point's 1 / z: the scale is the ratio of the mean
/// absolute deviations from the median, and the offset maps median to median. Nothing for fewer than
/// kMinAlignmentPoints, or if the values or the inverse depths are all equal.
std::optional<DepthAlignment> align_depth(const std::vector<double>& values, const std::vector<double>& inverse_depths);

/// Removes alignments whose scale is too far from the median of all. Returns how many were removed.
int remove_unlikely_alignments(std::vector<std::optional<DepthAlignment>>& alignments);

}  // namespace b3dgs
