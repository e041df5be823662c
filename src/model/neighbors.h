// Distances to the nearest points, which give Gaussians their initial scale.
#pragma once

#include <vector>

namespace b3dgs {

/// Mean squared distance of each point to its 3 nearest neighbours (fewer if the cloud has fewer points), at least
/// 1e-7. `positions` is [N, 3]. Exact; runs on all cores. Duplicates of a point are neighbours at distance 0.
std::vector<float> mean_squared_neighbor_distances(const std::vector<float>& positions);

}  // namespace b3dgs
