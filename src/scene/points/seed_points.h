// Initial points found in the photographs.
#pragma once

#include <cstdint>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/images/image.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

/// What seed_points() needs of a view.
struct SeedView {
  Camera camera;   // in a frame of which kTypicalDepth is the typical depth (choose_frame())
  Image8 image;    // RGB, of the camera's size; about kSeedSide px a side are enough
  Image8 content;  // one channel of the same size: 0 where nothing is; without pixels: anything may be anywhere
  Image8 valid;    // the same: 0 where the photograph does not count (View::valid)
};

inline constexpr int kSeedSide = 160;

/// What seed_points() does with pixels whose depth is not clear.
enum class SeedDepth {
  kAny,    // gives them that of the nearest pixel for which it is, or a random one
  kClear,  // leaves them out
};

/// About `n` points on the surfaces that the views show, with their colours. For random pixels, the depth at which the
/// pixel's surroundings look alike in neighbouring views (a plane sweep: Collins, "A space-sweep approach to true
/// multi-image matching", CVPR 1996); where that is not clear, as on plain walls, with SeedDepth::kAny the depth of
/// the nearest pixel for which it is; where there is none, or fewer than three views, a random one, from half to twice
/// kTypicalDepth. No point is where a view shows that nothing is, or close in front of a camera. There are fewer than
/// `n` where most pixels show nothing, or with kClear. The same views always give the same points.
PointCloud seed_points(const std::vector<SeedView>& views, std::int64_t n, SeedDepth depth = SeedDepth::kAny);

}  // namespace b3dgs
