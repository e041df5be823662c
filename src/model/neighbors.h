// Distances to the nearest points, which determine the initial scale of Gaussians.
#pragma once

#include <vector>

namespace b3dgs {

/// Returns the mean squared distance of each point to its 3 nearest neighbours (fewer if the cloud has fewer points),
/// at least 1e-7. `positions` is [N, 3]. The result is exact, and all cores are used. Duplicates of a point are
/// neighbours at distance 0.
std::vector<float> mean_squared_neighbor_distances(const std::vector<float>& positions);

}  // namespace b3dgs
