// The CPU rasterizer and its passes, in the order in which they run. Each pass is a function of its arguments.
#pragma once

#include <sys/mman.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <vector>

#include "core/parallel.h"
#include "raster/args.h"
#include "raster/checks.h"
#include "raster/geometry.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cpu {

/// Largest tile side that the CPU kernels support, px.
inline constexpr int kMaxTileSide = 32;

std::unique_ptr<RasterizerBackend> make_rasterizer();

/// Memory that only grows and is not initialised, because passes write every element before they read it.
template <class T>
class Buffer {
 public:
  /// Returns n or more elements with undefined contents. Reallocates, 25% larger, only if n exceeds the capacity.
  T* resize(std::int64_t n) {
    if (n > capacity_) {
      const std::int64_t grown = n + n / 4;
      data_.reset();
      data_.reset(static_cast<T*>(allocate(static_cast<std::size_t>(grown) * sizeof(T))));
      capacity_ = grown;
    }
    return data_.get();
  }
  T* data() const { return data_.get(); }

 private:
  struct Free {
    void operator()(T* memory) const { std::free(memory); }
  };
  /// Uses huge pages for large buffers. Passes visit splats and lists out of order, and with pages of 4 KiB most of
  /// these accesses would also miss the TLB.
  static void* allocate(std::size_t bytes) {
    constexpr std::size_t kLine = 64, kHugePage = std::size_t{2} << 20;
    const std::size_t alignment = bytes < 2 * kHugePage ? kLine : kHugePage;
    const std::size_t rounded = (bytes + alignment - 1) / alignment * alignment;
    void* const memory = std::aligned_alloc(alignment, rounded);
    if (memory == nullptr && rounded > 0) throw std::bad_alloc();
    if (alignment == kHugePage) madvise(memory, rounded, MADV_HUGEPAGE);
    return memory;
  }
  std::unique_ptr<T[], Free> data_;
  std::int64_t capacity_ = 0;
};

/// Prefetches an object that will be read or written soon. Passes visit splats and pairs in the order of depths or
/// tiles, in which they are scattered in memory.
template <class T>
void prefetch_object(const T& object) {
  const auto* const bytes = reinterpret_cast<const char*>(&object);
  __builtin_prefetch(bytes);
  if (sizeof(T) > alignof(T)) __builtin_prefetch(bytes + sizeof(T) - 1);  // it may end in another cache line
}

/// Projects Gaussians to the splats of one view, in the order of the Gaussians.
struct ProjectArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  RenderSettings settings{};
  TileGrid grid{};
  // Outputs. Splats and extents are [N], or [2 N] for a panorama, where the splat across the seam follows the first one
  // of its Gaussian. The first M are written. Radii are [N], and 0 if the Gaussian is not visible.
  SplatRowArrays out{};
  bool is_drawn = true;  // false: splats across the seam are counted but not written
};
/// @throws InvalidGaussianError naming the first invalid Gaussian
SplatCounts project(const ProjectArgs& args);

/// Binning: makes a list of splats for each tile, nearest first. Equal depths keep the order of the Gaussians.
struct BinArgs {
  const Splat* splats = nullptr;
  const Vec2f* extents = nullptr;
  const std::int32_t* radii = nullptr;  // [N]
  std::int64_t n_splats = 0;            // M
  TileGrid grid{};
  Culling culling = Culling::kEllipse;
  const char* indexed = "Gaussian";      // what Splat::gaussian is an index of, in errors
  std::int64_t n_pairs_max = kIndexMax;  // (tile, splat) pairs of a view
};
/// Buffers of binning, reused for every view.
struct BinBuffers {
  Buffer<std::int64_t> tile_offsets, slot_offsets, pair_slots, tile_counts;
  std::vector<std::vector<std::int32_t>> tiles;  // tiles of the splats of each chunk
  Buffer<std::int32_t> splat_ids;
  Buffer<std::uint64_t> keys, keys_swap;
};
/// @throws NumericError naming the widest Gaussian if there are too many pairs, before allocating memory for them
BinnedSplats bin(const BinArgs& args, BinBuffers& buffers);

/// The forward kernels: blend_forward_naive(), ...
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) void blend_forward_##id(const BlendForwardArgs& args);
B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

void score(const ScoreArgs& args);
void add_scores(const AddScoresArgs& args);

void blend_backward(const BlendBackwardArgs& args);

inline void add(SplatGrad& sum, const SplatGrad& part) {
  sum.log_alpha += part.log_alpha;
  sum.mean_x += part.mean_x;
  sum.mean_y += part.mean_y;
  sum.cov_xx += part.cov_xx;
  sum.cov_xy += part.cov_xy;
  sum.cov_yy += part.cov_yy;
  sum.red += part.red;
  sum.green += part.green;
  sum.blue += part.blue;
  sum.depth += part.depth;
}
inline void add(ScoreSums& sum, const ScoreSums& part) {
  sum.error += part.error;
  sum.weight += part.weight;
  sum.max_weight = std::max(sum.max_weight, part.max_weight);
}

/// Sums of the blending passes for each (tile, splat) pair.
template <class Sum>
struct PairSums {
  const Splat* splats = nullptr;               // [M]
  std::int64_t n_splats = 0;                   // M
  const std::int64_t* slot_offsets = nullptr;  // [n_pairs] indexed by slot
  const Sum* pairs = nullptr;                  // [n_pairs] by slot

  /// Returns whether splat m is the second one of its Gaussian, across the seam of a panorama. It and its slots follow
  /// those of the first.
  bool is_second(std::int64_t m) const { return m > 0 && splats[m - 1].gaussian == splats[m].gaussian; }
  /// Returns the sum of splats [m, end), in the order of their slots.
  Sum sum(std::int64_t m, std::int64_t end) const {
    Sum sum{};
    for (std::int64_t slot = slot_offsets[m]; slot < slot_offsets[end]; ++slot) add(sum, pairs[slot]);
    return sum;
  }
  /// Returns the sum of the Gaussian whose first splat is m.
  Sum of_gaussian(std::int64_t m) const { return sum(m, m + 1 < n_splats && is_second(m + 1) ? m + 2 : m + 1); }
  /// Calls visit(m, sum) for each Gaussian, where m is its first splat.
  template <class Visit>
  void visit_gaussians(Visit&& visit) const {
    constexpr std::int64_t kGrain = 1024;
    parallel_each(n_splats, kGrain, [&](std::int64_t m) {
      if (!is_second(m)) visit(m, of_gaussian(m));
    });
  }
};

/// Computes the planes of M splats. `out`: [M]
void splat_planes(const PlaneArgs& args, std::int64_t n_splats, const Splat* splats, PlaneRow* out);
/// Computes depth, normals and confidence of the surface that a view shows.
void geometry(const GeometryArgs& args);

/// Data that turns the sums of splats into gradients of Gaussians.
struct ProjectBackwardArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  int sh_degree = 0;
  bool antialiasing = false;
};
/// Backward projection. Computes gradients with respect to the stored parameters.
void project_backward(const ProjectBackwardArgs& args, const PairSums<SplatGrad>& sums, const GaussianGradArrays& out);

/// Computes the gradient with respect to the camera's pose. `out`: [kCameraGradients].
void camera_gradient(const ProjectBackwardArgs& args, const PairSums<SplatGrad>& sums, double* out);
/// The same in two halves, for splats rendered elsewhere. camera_parts() computes the contribution of each of M splats,
/// `parts` [M, kCameraGradients], and sum_camera_parts() adds them in order.
void camera_parts(const ProjectBackwardArgs& args, const SplatRows& rows, const SplatGradSum* splat_grads,
                  float* parts);
void sum_camera_parts(const float* parts, std::int64_t n_splats, double* out);

/// Stores the sums of splats for a later backward projection.
void keep_splat_records(const PairSums<SplatGrad>& sums, std::int64_t n_gaussians, const SplatRecordArrays& out);
void keep_splats(const KeepSplatsArgs& args);

}  // namespace b3dgs::cpu
