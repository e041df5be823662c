// A k-d tree. Unlike a grid, it is fast for clouds of very uneven density, such as those of LiDAR.
#include "model/neighbors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {
namespace {

constexpr int kNeighbors = 3;
constexpr std::int64_t kLeafSize = 10;          // most points in a leaf; 6 to 16 are about equally fast
constexpr float kMinSquaredDistance = 1e-7f;    // keeps the scale of duplicates above 0
constexpr std::int64_t kQueriesPerTask = 4096;  // close to each other in space, so their data stays in the cache

struct Point {
  std::array<float, 3> position;
  std::int64_t row;  // index in the caller's array
};

// The smallest squared distances so far, ascending.
using Nearest = std::array<float, kNeighbors>;

void offer(float squared, Nearest& nearest) {
  if (!(squared < nearest.back())) return;
  int i = kNeighbors - 1;
  for (; i > 0 && nearest[i - 1] > squared; --i) nearest[i] = nearest[i - 1];
  nearest[i] = squared;
}

// Distances and their bounds are summed in the same order. Rounding is monotonic, so a bound with smaller or equal
// components never exceeds the distance, and pruning is exact.
float squared_norm(const std::array<float, 3>& v) {
  return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

// Balanced, without pointers: level d divides the points into 2^d runs whose lengths differ by at most one. Run i of
// level d is node 2^d + i. Runs are halved at the median of their widest axis until they have at most kLeafSize points.
class KdTree {
 public:
  explicit KdTree(const std::vector<float>& positions) : points_(positions.size() / 3) {
    const std::int64_t n = size();
    for (std::int64_t i = 0; i < n; ++i) {
      points_[i] = {{positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]}, i};
    }
    while ((n >> depth_) > kLeafSize) ++depth_;
    splits_.resize(std::size_t{1} << depth_);
    for (int level = 0; level < depth_; ++level) {
      parallel_pool(std::int64_t{1} << level, [&](std::int64_t run, int) { split_run(level, run); });
    }
  }

  std::int64_t size() const { return static_cast<std::int64_t>(points_.size()); }
  std::int64_t row(std::int64_t index) const { return points_[index].row; }

  /// `index` is in the order of the tree, not the caller's.
  float mean_squared_distance(std::int64_t index) const {
    Nearest nearest;
    nearest.fill(std::numeric_limits<float>::infinity());
    search(1, 0, {0, 0, 0}, index, nearest);
    float sum = 0;
    int found = 0;
    for (; found < kNeighbors && std::isfinite(nearest[found]); ++found) sum += nearest[found];
    return found > 0 ? sum / static_cast<float>(found) : 0.0f;
  }

 private:
  struct Split {
    float value = 0;
    int axis = 0;
  };

  std::int64_t begin_of(int level, std::int64_t run) const { return (size() * run) >> level; }

  void split_run(int level, std::int64_t run) {
    const auto begin = points_.begin() + begin_of(level, run), end = points_.begin() + begin_of(level, run + 1);
    const auto middle = points_.begin() + begin_of(level + 1, 2 * run + 1);
    std::array<float, 3> low = begin->position, high = begin->position;
    for (auto point = begin; point != end; ++point) {
      for (int axis = 0; axis < 3; ++axis) {
        low[axis] = std::min(low[axis], point->position[axis]);
        high[axis] = std::max(high[axis], point->position[axis]);
      }
    }
    int axis = 0;
    for (int other = 1; other < 3; ++other) {
      if (high[other] - low[other] > high[axis] - low[axis]) axis = other;
    }
    std::nth_element(begin, middle, end,
                     [axis](const Point& a, const Point& b) { return a.position[axis] < b.position[axis]; });
    splits_[(std::size_t{1} << level) + run] = {middle->position[axis], axis};
  }

  // `gap` is a lower bound of the query's distance to the node's box on each axis.
  void search(std::int64_t node, int level, const std::array<float, 3>& gap, std::int64_t query,
              Nearest& nearest) const {
    const std::array<float, 3>& position = points_[query].position;
    if (level == depth_) {
      const std::int64_t run = node - (std::int64_t{1} << level);
      for (std::int64_t i = begin_of(level, run); i < begin_of(level, run + 1); ++i) {
        if (i == query) continue;
        const std::array<float, 3>& other = points_[i].position;
        offer(squared_norm({other[0] - position[0], other[1] - position[1], other[2] - position[2]}), nearest);
      }
      return;
    }
    const Split split = splits_[node];
    const float offset = position[split.axis] - split.value;
    const std::int64_t near = 2 * node + (offset < 0 ? 0 : 1);
    search(near, level + 1, gap, query, nearest);
    std::array<float, 3> far_gap = gap;
    far_gap[split.axis] = std::abs(offset);
    if (squared_norm(far_gap) < nearest.back()) search(near ^ 1, level + 1, far_gap, query, nearest);
  }

  std::vector<Point> points_;
  std::vector<Split> splits_;  // by node; the root is node 1
  int depth_ = 0;
};

}  // namespace

std::vector<float> mean_squared_neighbor_distances(const std::vector<float>& positions) {
  B3DGS_CHECK(positions.size() % 3 == 0, "expected positions [N, 3], found ", positions.size(), " values");
  for (std::size_t i = 0; i < positions.size(); ++i) {
    B3DGS_CHECK(std::isfinite(positions[i]), "the position of point ", i / 3, " is not finite");
  }
  const KdTree tree(positions);
  std::vector<float> result(tree.size());
  parallel_pool((tree.size() + kQueriesPerTask - 1) / kQueriesPerTask, [&](std::int64_t task, int) {
    const std::int64_t end = std::min(tree.size(), (task + 1) * kQueriesPerTask);
    for (std::int64_t i = task * kQueriesPerTask; i < end; ++i) {
      result[tree.row(i)] = std::max(tree.mean_squared_distance(i), kMinSquaredDistance);
    }
  });
  return result;
}

}  // namespace b3dgs
