// What the host reads of ViewCounts, and the errors that follow from it.
#pragma once

#include <atomic>
#include <type_traits>
#include <utility>
#include <vector>

#include "raster/checks.h"
#include "raster/cuda/device_buffer.h"
#include "raster/cuda/passes.h"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// @throws InvalidGaussianError if projection found an invalid Gaussian
inline void check_valid(const ViewCounts& counts) {
  if (counts.first_invalid < 0) return;
  throw InvalidGaussianError(counts.first_invalid, detail::concat("Gaussian ", counts.first_invalid, kInvalidText));
}

/// Counts of a view, on their way to the host. In pinned memory: kernels write them there, since a copy would let the
/// next kernel start several microseconds later.
class CountsReader {
 public:
  /// What kernels of this view may write. Those of the view before have ended, also if an error left them unread.
  ViewCounts* begin() {
    if (std::exchange(is_pending_, true)) written_.wait();
    ViewCounts* const counts = host_.get();
    *counts = {};
    counts->first_invalid = -1;
    counts->n_pairs = kUnwritten;
    return counts;
  }
  /// Instead, copies counts in device memory.
  void copy(const ViewCounts* counts, const LaunchContext& context) {
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(host_.get(), counts, sizeof(ViewCounts), cudaMemcpyDeviceToHost, context.stream));
    mark(context);
  }
  /// Everything queued so far writes the counts.
  void mark(const LaunchContext& context) {
    is_pending_ = true;
    written_.record(context.stream);
  }
  /// @throws InvalidGaussianError
  ViewCounts wait() {
    finish();
    check_valid(*host_.get());
    return *host_.get();
  }
  /// The same of a kernel that writes n_pairs last, before it ends.
  ViewCounts poll() {
    const volatile std::int64_t& n_pairs = host_.get()->n_pairs;
    for (int turn = 1; n_pairs == kUnwritten; ++turn) {
      constexpr int kTurns = 1000;  // a query takes longer than a read, but finds errors of the device
      if (turn % kTurns == 0 && written_.is_reached()) break;
    }
    std::atomic_thread_fence(std::memory_order_acquire);
    is_pending_ = false;
    check_valid(*host_.get());
    return *host_.get();
  }
  /// Waits until no kernel writes.
  void finish() {
    written_.wait();
    is_pending_ = false;
  }

 private:
  static constexpr std::int64_t kUnwritten = -1;
  PinnedValue<ViewCounts> host_;
  StreamMark written_;
  bool is_pending_ = false;  // what was marked has not been waited for
};

/// For the error message about too many pairs. Waits for the device.
inline WidestGaussian widest_gaussian(const ProjectOutputs& projected, std::int64_t n_rows, const TileGrid& grid,
                                      Culling culling, const LaunchContext& context) {
  const auto download = [&](const auto* device) {
    std::vector<std::remove_const_t<std::remove_pointer_t<decltype(device)>>> host(static_cast<std::size_t>(n_rows));
    B3DGS_CUDA_CHECK(
        cudaMemcpyAsync(host.data(), device, host.size() * sizeof(host[0]), cudaMemcpyDeviceToHost, context.stream));
    B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));
    return host;
  };
  const std::vector<Splat> splats = download(projected.splats);
  const std::vector<Vec2f> extents = download(projected.extents);
  const std::vector<std::int32_t> radii = download(projected.radii);
  WidestGaussian widest{};
  for (std::size_t i = 0; i < splats.size(); ++i) {
    const std::int32_t n_tiles = radii[i] > 0 ? tiles_touched(grid, culling, splats[i], extents[i], radii[i]) : 0;
    if (n_tiles > widest.n_tiles) widest = {splats[i].gaussian, n_tiles};
  }
  return widest;
}

}  // namespace b3dgs::cuda
