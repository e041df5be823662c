#include "app/mesh/tsdf_volume.h"

#include <openvdb/openvdb.h>
#include <openvdb/tools/VolumeToMesh.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "app/mesh/voxel_views.h"
#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {
namespace {

using Vec = Vec3<double>;
using Grid = openvdb::FloatGrid;
using Leaf = Grid::TreeType::LeafNodeType;
using openvdb::Coord;

constexpr int kBlockSide = 8;
static_assert(Leaf::DIM == kBlockSide);
constexpr std::int64_t kBytesPerBlock = 15000;  // of the grid, the extraction of its surface, and the lists of both
constexpr std::size_t kFewestBlocks = 27;       // one with its neighbours
// A vertex belongs to the cell that its coordinates fall into. Distances of almost 0 would put it on the border between
// two cells, so they become this, in voxels. Single precision tells such vertices apart up to kMostBlocks.
constexpr double kLeastDistance = 1.0 / 256;
constexpr int kMostBlocks = 2048;  // along one axis

/// Blocks from `low` to below `high`.
struct Box {
  Block low{}, high{};

  bool contains(const Block& block, int margin = 0) const {
    for (std::size_t i = 0; i < 3; ++i) {
      if (block[i] < low[i] - margin || block[i] >= high[i] + margin) return false;
    }
    return true;
  }
};

Box bounds_of(const std::vector<Block>& blocks) {
  Box box{blocks.front(), blocks.front()};
  for (const Block& block : blocks) {
    for (std::size_t i = 0; i < 3; ++i) {
      box.low[i] = std::min(box.low[i], block[i]);
      box.high[i] = std::max(box.high[i], block[i] + 1);
    }
  }
  return box;
}

void sort_unique(std::vector<Block>& blocks) {
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
}

std::vector<Block> blocks_near_view(const DepthView& view, const FusionSettings& settings) {
  const std::vector<Vec3f> rays = pixel_rays(view.camera);
  const std::array<double, 3> center = view.camera.center();
  const double side = kBlockSide * settings.voxel;
  const int n_steps = static_cast<int>(std::ceil(settings.truncation / 2));  // of at most two voxels, to each side
  std::vector<Block> blocks, last(static_cast<std::size_t>(2 * n_steps) + 1);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (!(view.depth[i] > 0)) continue;
    const std::array<double, 3> ray =
        rotated_back(view.camera.cam_from_world.rotation, {rays[i].x, rays[i].y, rays[i].z});
    const double step = settings.truncation * settings.voxel / (n_steps * std::hypot(ray[0], ray[1], ray[2]));
    for (int k = -n_steps; k <= n_steps; ++k) {
      Block block;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double at = std::floor((center[axis] + (view.depth[i] + k * step) * ray[axis]) / side);
        block[axis] = static_cast<std::int32_t>(std::clamp(at, -1e9, 1e9));
      }
      Block& previous = last[static_cast<std::size_t>(k + n_steps)];  // on the ray of the pixel before
      if (!blocks.empty() && block == previous) continue;
      previous = block;
      blocks.push_back(block);
    }
  }
  sort_unique(blocks);
  return blocks;
}

/// A face of the surface and the voxel at the beginning of the edge that it crosses. This order of faces does not
/// depend on how the grid is divided.
struct Quad {
  std::uint64_t edge = 0;  // voxel and axis
  std::array<std::uint32_t, 4> corners{};
};

/// The surface of all cubes. Vertices on the border between cubes occur once in each.
struct Surface {
  std::vector<Vec3f> points;  // voxels
  std::vector<Quad> quads;
};

class Fusion {
 public:
  Fusion(const std::vector<DepthView>& views, const Box& bounds, const FusionSettings& settings) : settings_(settings) {
    for (std::size_t i = 0; i < 3; ++i) middle_[i] = (bounds.low[i] + bounds.high[i]) / 2;
    for (const DepthView& view : views) views_.emplace_back(view, settings.voxel, origin());
  }

  /// Calls add_cube() for parts of the box with so few blocks that they fit into memory.
  void add_box(const Box& box, const std::vector<Block>& blocks) {
    std::vector<Block> near;  // with those around the box, which its border needs
    bool has_own = false;
    for (const Block& block : blocks) {
      if (box.contains(block, 1)) near.push_back(block);
      has_own = has_own || box.contains(block);
    }
    if (!has_own) return;
    const auto most = static_cast<std::size_t>(settings_.memory / kBytesPerBlock);
    if (near.size() <= std::max(most, kFewestBlocks)) {
      add_cube(box, near);
      return;
    }
    std::size_t longest = 0;
    for (const std::size_t axis : {1, 2}) {
      if (box.high[axis] - box.low[axis] > box.high[longest] - box.low[longest]) longest = axis;
    }
    Box first = box, second = box;
    first.high[longest] = second.low[longest] = (box.low[longest] + box.high[longest]) / 2;
    add_box(first, near);
    add_box(second, near);
  }

  TriangleMesh mesh();

 private:
  Vec origin() const {
    return {1.0 * kBlockSide * middle_[0], 1.0 * kBlockSide * middle_[1], 1.0 * kBlockSide * middle_[2]};
  }
  Coord first_voxel(const Block& block) const {
    return {kBlockSide * (block[0] - middle_[0]), kBlockSide * (block[1] - middle_[1]),
            kBlockSide * (block[2] - middle_[2])};
  }
  void fill(Leaf& leaf) const;
  void add_cube(const Box& box, const std::vector<Block>& blocks);
  void weld();

  const FusionSettings settings_;
  Block middle_{};  // the block at the origin of the grid
  std::vector<VoxelView> views_;
  Surface surface_;
};

void Fusion::fill(Leaf& leaf) const {
  constexpr double kHalf = 0.5 * (kBlockSide - 1);
  const auto at = [](const Coord& c) { return Vec{1.0 * c.x(), 1.0 * c.y(), 1.0 * c.z()}; };
  std::vector<const VoxelView*> views;
  for (const VoxelView& view : views_) {
    if (view.may_see(at(leaf.origin()) + Vec{kHalf, kHalf, kHalf}, kHalf * std::sqrt(3.0))) views.push_back(&view);
  }
  const double truncation = settings_.truncation * settings_.voxel;
  for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
    const Vec voxel = at(leaf.offsetToGlobalCoord(i));
    double sum = 0, weight = 0;
    for (const VoxelView* view : views) view->add(voxel, truncation, sum, weight);
    if (!(weight > 0)) continue;
    const double distance = sum / weight / settings_.voxel;
    leaf.setValueOn(
        i, static_cast<float>(distance < 0 ? std::min(distance, -kLeastDistance) : std::max(distance, kLeastDistance)));
  }
}

/// Returns the cell that a vertex is in, by its first corner.
Coord cell_of(const openvdb::Vec3s& point) {
  return Coord::floor(point);
}

/// Returns whether both ends of each edge of a cell that the surface crosses have been seen. Between the voxels just
/// behind a surface and those that no view sees, there is another zero, which is not a surface.
bool is_crossing_seen(const Grid::ConstAccessor& accessor, const Coord& cell) {
  std::array<float, 8> values{};
  std::array<bool, 8> is_seen{};
  for (int i = 0; i < 8; ++i) {
    const auto corner = static_cast<std::size_t>(i);
    is_seen[corner] = accessor.probeValue(cell.offsetBy(i & 1, i >> 1 & 1, i >> 2), values[corner]);
  }
  for (const std::size_t axis : {1, 2, 4}) {
    for (std::size_t from = 0; from < 8; ++from) {
      const std::size_t to = from | axis;
      if ((values[from] < 0) != (values[to] < 0) && !(is_seen[from] && is_seen[to])) return false;
    }
  }
  return true;
}

void Fusion::add_cube(const Box& box, const std::vector<Block>& blocks) {
  // Seen voxels are active.
  const Grid::Ptr grid = Grid::create(static_cast<float>(settings_.truncation));
  std::vector<Leaf*> leaves;
  for (const Block& block : blocks) leaves.push_back(grid->tree().touchLeaf(first_voxel(block)));
  parallel_pool(static_cast<std::int64_t>(leaves.size()),
                [&](std::int64_t i, int) { fill(*leaves[static_cast<std::size_t>(i)]); });

  std::vector<openvdb::Vec3s> points;
  std::vector<openvdb::Vec4I> quads;
  openvdb::tools::volumeToMesh(*grid, points, quads);

  std::vector<char> is_kept(points.size());
  parallel_chunks(static_cast<std::int64_t>(points.size()), 4096, [&](std::int64_t begin, std::int64_t end) {
    const Grid::ConstAccessor accessor = grid->getConstAccessor();
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      is_kept[i] = is_crossing_seen(accessor, cell_of(points[i]));
    }
  });

  constexpr std::uint32_t kNone = ~0u;
  std::vector<std::uint32_t> ids(points.size(), kNone);
  for (const openvdb::Vec4I& quad : quads) {
    if (!(is_kept[quad[0]] && is_kept[quad[1]] && is_kept[quad[2]] && is_kept[quad[3]])) continue;
    Coord first = cell_of(points[quad[0]]), last = first;
    for (int i = 1; i < 4; ++i) {
      first.minComponent(cell_of(points[quad[i]]));
      last.maxComponent(cell_of(points[quad[i]]));
    }
    const Block own{middle_[0] + (last.x() >> 3), middle_[1] + (last.y() >> 3), middle_[2] + (last.z() >> 3)};
    if (!box.contains(own)) continue;
    constexpr int kShift = kBlockSide * kMostBlocks / 2;
    const int axis = first.x() == last.x() ? 0 : first.y() == last.y() ? 1 : 2;
    Quad kept;
    for (const int value : {last.x(), last.y(), last.z()}) {
      kept.edge = kept.edge * (2 * kShift) + static_cast<std::uint64_t>(value + kShift);
    }
    kept.edge = 3 * kept.edge + static_cast<std::uint64_t>(axis);
    for (int i = 0; i < 4; ++i) {
      std::uint32_t& id = ids[quad[i]];
      if (id == kNone) {
        id = static_cast<std::uint32_t>(surface_.points.size());
        const openvdb::Vec3s& p = points[quad[i]];
        surface_.points.push_back({p[0], p[1], p[2]});
      }
      kept.corners[static_cast<std::size_t>(i)] = id;
    }
    surface_.quads.push_back(kept);
  }
}

/// Makes one vertex of those with the same position.
void Fusion::weld() {
  const std::vector<Vec3f>& points = surface_.points;
  std::vector<std::uint32_t> order(points.size()), ids(points.size());
  std::iota(order.begin(), order.end(), 0u);
  const auto compare = [&](std::uint32_t a, std::uint32_t b) { return std::memcmp(&points[a], &points[b], 12); };
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return compare(a, b) < 0; });
  for (std::size_t i = 0; i < order.size(); ++i) {
    ids[order[i]] = i > 0 && compare(order[i], order[i - 1]) == 0 ? ids[order[i - 1]] : order[i];
  }
  for (Quad& quad : surface_.quads) {
    for (std::uint32_t& corner : quad.corners) corner = ids[corner];
  }
}

TriangleMesh Fusion::mesh() {
  weld();
  std::sort(surface_.quads.begin(), surface_.quads.end(), [](const Quad& a, const Quad& b) { return a.edge < b.edge; });
  constexpr std::uint32_t kNone = ~0u;
  std::vector<std::uint32_t> ids(surface_.points.size(), kNone);  // vertices are numbered at their first use
  TriangleMesh mesh;
  mesh.triangles.reserve(2 * surface_.quads.size());
  for (Quad& quad : surface_.quads) {
    for (std::uint32_t& corner : quad.corners) {
      if (ids[corner] == kNone) {
        ids[corner] = static_cast<std::uint32_t>(mesh.positions.size());
        const Vec3f& p = surface_.points[corner];
        const Vec at = settings_.voxel * (origin() + Vec{p.x, p.y, p.z});
        mesh.positions.push_back({static_cast<float>(at.x), static_cast<float>(at.y), static_cast<float>(at.z)});
      }
      corner = ids[corner];
    }
    const std::array<std::uint32_t, 4>& c = quad.corners;
    const Vec one = mesh.position(c[0]) - mesh.position(c[2]), other = mesh.position(c[1]) - mesh.position(c[3]);
    const std::size_t start = dot(one, one) <= dot(other, other) ? 0 : 1;  // the shorter diagonal
    mesh.triangles.push_back({c[start], c[start + 1], c[start + 2]});
    mesh.triangles.push_back({c[start], c[start + 2], c[(start + 3) % 4]});
  }
  return mesh;
}

}  // namespace

std::vector<Block> blocks_near(const std::vector<DepthView>& views, const FusionSettings& settings) {
  std::vector<std::vector<Block>> of_views(views.size());
  parallel_pool(static_cast<std::int64_t>(views.size()), [&](std::int64_t i, int) {
    of_views[static_cast<std::size_t>(i)] = blocks_near_view(views[static_cast<std::size_t>(i)], settings);
  });
  std::vector<Block> all;
  for (const std::vector<Block>& blocks : of_views) all.insert(all.end(), blocks.begin(), blocks.end());
  sort_unique(all);
  if (all.empty()) return all;
  const Box box = bounds_of(all);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int64_t n = std::int64_t{box.high[axis]} - box.low[axis];
    if (n <= kMostBlocks) continue;
    input_error("--voxel ", settings.voxel, ": expected a surface of at most ", kBlockSide * kMostBlocks,
                " voxels along each axis, found ", kBlockSide * n, "; use --voxel ",
                settings.voxel * static_cast<double>(n) / kMostBlocks, " or more, or a smaller --far");
  }
  return all;
}

TriangleMesh fuse(const std::vector<DepthView>& views, const std::vector<Block>& blocks,
                  const FusionSettings& settings) {
  if (blocks.empty()) return {};
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(thread_count()));
  const Box bounds = bounds_of(blocks);
  Fusion fusion(views, bounds, settings);
  fusion.add_box(bounds, blocks);
  return fusion.mesh();
}

}  // namespace b3dgs
