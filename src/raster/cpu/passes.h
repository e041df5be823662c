// Memory that only grows and is not initialised: passes write every element before they read it.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <vector>

#include "raster/args.h"
#include "raster/checks.h"
#include "raster/rasterizer_backend.h"
#include "raster/splat_rows.h"

namespace b3dgs::cpu {

template <class T>
class Buffer {
 public:
  /// At least n elements with undefined contents. Reallocates, with a quarter to spare, only if n exceeds the capacity.
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
  /// Large buffers ask for huge pages: passes visit splats and lists out of order, and with pages of 4 KiB most of
  /// these accesses would miss the TLB, too.
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

/// Fetches an object that will be read or written soon. Splats and pairs are visited in the order of depths or of
/// tiles, in which they are scattered in memory.
template <class T>
void prefetch_object(const T& object) {
  const auto* const bytes = reinterpret_cast<const char*>(&object);
  __builtin_prefetch(bytes);
  if (sizeof(T) > alignof(T)) __builtin_prefetch(bytes + sizeof(T) - 1);  // it may end in another cache line
}

// The CPU rasterizer, and its passes, each a function of its arguments, in the order in which they run.

/// Largest tile side that the CPU kernels support, px.
inline constexpr int kMaxTileSide = 32;

std::unique_ptr<RasterizerBackend> make_rasterizer();

/// @throws InvalidGaussianError naming the first invalid Gaussian
SplatCounts project(const ProjectArgs& args);

/// In place of project(): splats that were projected elsewhere, numbered as Gaussians, row by row. Returns M.
/// Parameters of Gaussians are not used.
std::int64_t load_rows(const SplatRows& rows, const ProjectArgs& args);

/// Whether splat m is the second one of its Gaussian, across the seam of a panorama: it follows the first, and so do
/// its slots.
inline bool is_across_the_seam(const Splat* splats, std::int64_t m) {
  return m > 0 && splats[m - 1].gaussian == splats[m].gaussian;
}

/// Buffers of binning, reused from view to view.
struct BinBuffers {
  Buffer<std::int64_t> tile_offsets, slot_offsets, pair_slots, tile_counts;
  std::vector<std::vector<std::int32_t>> tiles;  // of the splats of each chunk
  Buffer<std::int32_t> splat_ids;
  Buffer<std::uint64_t> keys, keys_swap;
};
/// @throws NumericError naming the widest Gaussian if there are too many pairs, before memory is taken for them
BinnedSplats bin(const BinArgs& args, BinBuffers& buffers, const PairLimit& limit = {});

/// The forward kernels: blend_forward_naive(), ...
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) void blend_forward_##id(const BlendForwardArgs& args);
B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

/// Runs one of them.
void blend_forward(ForwardKernel kernel, const BlendForwardArgs& args);

void count_load(const CountLoadArgs& args);

void score(const ScoreArgs& args);

void add_scores(const AddScoresArgs& args);

/// Sums of each splat's pairs, for splats whose Gaussians are elsewhere.
struct SumScoresArgs {
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const ScoreSums* sums = nullptr;             // [n_pairs] by slot
  ScoreSums* out = nullptr;                    // [M] out; padding is 0
};
void sum_scores(const SumScoresArgs& args);

void blend_backward(const BlendBackwardArgs& args);

void project_backward(const ProjectBackwardArgs& args);

/// The sum over a splat's pairs, in the order of their slots, [first, last).
inline SplatGrad sum_slots(const SplatGrad* first, const SplatGrad* last) {
  SplatGrad sum{};
  for (const SplatGrad* part = first; part != last; ++part) {
    sum.log_alpha += part->log_alpha;
    sum.mean_x += part->mean_x;
    sum.mean_y += part->mean_y;
    sum.cov_xx += part->cov_xx;
    sum.cov_xy += part->cov_xy;
    sum.cov_yy += part->cov_yy;
    sum.red += part->red;
    sum.green += part->green;
    sum.blue += part->blue;
    sum.depth += part->depth;
  }
  return sum;
}

/// Sums of each splat's pairs, for a later backward projection.
struct SplatRecordArgs {
  std::int64_t n_gaussians = 0, n_splats = 0;
  const Splat* splats = nullptr;               // [M]
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGrad* pair_grads = nullptr;       // [n_pairs] by slot
  SplatRecordArrays out{};
};
void keep_splat_records(const SplatRecordArgs& args);

/// Sums of each splat's pairs, for splats whose Gaussians are elsewhere.
struct SumSplatGradsArgs {
  std::int64_t n_splats = 0;
  const std::int64_t* slot_offsets = nullptr;  // [M + 1]
  const SplatGrad* pair_grads = nullptr;       // [n_pairs] by slot
  SplatGradSum* out = nullptr;                 // [M] out
};
void sum_splat_grads(const SumSplatGradsArgs& args);

void keep_splats(const KeepSplatsArgs& args);

/// Gradient with respect to the camera's pose; args.grad is not used. `out`: [kCameraGradients].
void camera_gradient(const ProjectBackwardArgs& args, double* out);
/// The same in two halves, for splats that were drawn elsewhere: what each of them adds, and the sum, in their order.
void camera_parts(const CameraPartsArgs& args);
void sum_camera_parts(const float* parts, std::int64_t n_splats, double* out);

}  // namespace b3dgs::cpu
