// Points with colours, from structure from motion or LiDAR, and their PLY files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/images/image.h"

namespace b3dgs {

class FileReader;
class PlyReader;

template <class Real>
struct Points {
  std::vector<Real> positions;       // [N, 3]
  std::vector<std::uint8_t> colors;  // [N, 3] RGB
  std::string left_out{};            // a warning about unusable points of the file, or ""

  std::int64_t size() const { return static_cast<std::int64_t>(positions.size() / 3); }
};
using PointCloud = Points<float>;    // in the frame of the scene
using WorldPoints = Points<double>;  // in world coordinates, as in files

PointCloud in_frame(const CoordinateFrame& frame, const WorldPoints& points);
WorldPoints in_world(const CoordinateFrame& frame, const PointCloud& points);

/// Writes x y z as float, or as double if `frame`, the frame of the points, is far from the world's origin. Writes red
/// green blue as uchar. @throws IoError
void write_point_ply(const std::filesystem::path& path, const PointCloud& points, const CoordinateFrame& frame = {});

/// Reads x, y, z and colours by name, in any order and of any scalar type, from binary (both byte orders) or ASCII
/// files. Colours of type float and double range from 0 to 1, 16-bit colours are reduced to 8 bits, and points without
/// colours become mid-grey. Leaves out points with values that are not finite (Points::left_out). @throws InputError,
/// also if no point is left
WorldPoints read_point_ply(const std::filesystem::path& path);
WorldPoints read_point_ply(FileReader& file);

/// Returns the header of a little-endian file of vertices with these properties (name and type).
std::string ply_header(std::int64_t n_vertices, const std::vector<std::pair<std::string, const char*>>& properties,
                       const std::string& comment = "");

/// @throws InputError for SuperSplat's compressed PLY and models of 2D Gaussian Splatting, whose columns differ
void refuse_other_ply(const PlyReader& reader);

// Initial points found in the photographs.

/// A view, as seed_points() needs it.
struct SeedView {
  Camera camera;   // in a frame with typical depth kTypicalDepth (choose_frame())
  Image8 image;    // RGB, of the camera's size; about kSeedSide px a side are enough
  Image8 content;  // one channel of the same size: 0 where the scene is empty; without pixels: nowhere
  Image8 valid;    // the same: 0 where the photograph is masked (View::valid)
};

inline constexpr int kSeedSide = 160;

/// How seed_points() treats pixels without a clear depth.
enum class SeedDepth {
  kAny,    // gives them the depth of the nearest pixel with a clear one, or a random one
  kClear,  // leaves them out
};

/// Returns about `n` points on the surfaces that the views show, with their colours. The depth of a random pixel is the
/// one at which its surroundings look alike in neighbouring views (a plane sweep: Collins, "A space-sweep approach to
/// true multi-image matching", CVPR 1996). On plain walls, for example, this depth is not clear. With SeedDepth::kAny,
/// such a pixel gets the depth of the nearest pixel with a clear one. If there is none, or with fewer than three views,
/// its depth is random, from half to twice kTypicalDepth. Points never lie where a view shows empty space, or close in
/// front of a camera. There are fewer than `n` where most pixels are empty, or with kClear. The same views always give
/// the same points.
PointCloud seed_points(const std::vector<SeedView>& views, std::int64_t n, SeedDepth depth = SeedDepth::kAny);

}  // namespace b3dgs
