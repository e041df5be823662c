// Fuses depth images into a truncated signed distance on a sparse grid, and extracts its surface (OpenVDB).
//
// The distance of a voxel is the mean over the views that see it of (depth of the surface - depth of the voxel), along
// the axis of the camera. It is clamped to the truncation and weighted by (cosine / depth)^2. Voxels farther behind the
// surface than the truncation are hidden from a view.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "app/mesh/depth_views.h"
#include "model/formats/triangle_mesh.h"

namespace b3dgs {

/// Position of a block of 8^3 voxels, in blocks from the origin of the coordinates.
using Block = std::array<std::int32_t, 3>;

struct FusionSettings {
  double voxel = 0;         // side of a voxel
  double truncation = 4;    // voxels
  std::int64_t memory = 0;  // bytes for the grid and its surface; if there are more, it is divided into cubes
};

/// Returns the blocks within the truncation of a depth, sorted. @throws InputError if the voxel is too small for the
/// extent of the depths
std::vector<Block> blocks_near(const std::vector<DepthView>& views, const FusionSettings& settings);

/// Returns the surface in `blocks`. It ends where the voxels on either side have not been seen. The result does not
/// depend on the number of threads or the memory.
TriangleMesh fuse(const std::vector<DepthView>& views, const std::vector<Block>& blocks,
                  const FusionSettings& settings);

}  // namespace b3dgs
