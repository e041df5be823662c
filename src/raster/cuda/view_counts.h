// Counts of a view that the host reads during a forward pass, the errors that follow from them, and a stream for
// concurrent passes.
#pragma once

#include <atomic>
#include <type_traits>
#include <vector>

#include "core/cuda_handles.h"
#include "raster/checks.h"
#include "raster/cuda/passes.h"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Returns `counts`. @throws InvalidGaussianError if projection found an invalid Gaussian
inline const ViewCounts& valid(const ViewCounts& counts) {
  if (counts.first_invalid < 0) return counts;
  throw InvalidGaussianError(counts.first_invalid, detail::concat("Gaussian ", counts.first_invalid, kInvalidText));
}

inline void record(const Event& event, cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaEventRecord(event.get(), stream));
}
inline void wait_for(const Event& event) {
  B3DGS_CUDA_CHECK(cudaEventSynchronize(event.get()));
}

/// ViewCounts in pinned memory, which copies and kernels may write.
class PinnedCounts {
 public:
  ViewCounts* get() const { return reinterpret_cast<ViewCounts*>(memory_.get()); }

 private:
  PinnedMemory memory_ = make_pinned_memory(sizeof(ViewCounts));
};

/// Transfers the counts of a view to the host. Kernels write them to pinned memory, because a copy would delay the next
/// kernel by several microseconds.
class CountsReader {
 public:
  /// Returns the counts for the kernels of this view. Waits for kernels of the previous view, whose counts an error may
  /// have left unread.
  ViewCounts* begin() {
    wait_for(written_);
    *host_.get() = {};
    host_.get()->n_pairs = kUnwritten;
    return host_.get();
  }
  /// Call when all kernels that write the counts are queued.
  void mark(const LaunchContext& context) { record(written_, context.stream); }
  /// Waits for the counts. @throws InvalidGaussianError
  const ViewCounts& wait() {
    wait_for(written_);
    return valid(*host_.get());
  }
  /// The same for a kernel that writes n_pairs last. Returns before the kernel ends.
  const ViewCounts& poll() {
    const volatile std::int64_t& n_pairs = host_.get()->n_pairs;
    for (int turn = 1; n_pairs == kUnwritten; ++turn) {
      constexpr int kTurns = 1000;  // a query takes longer than a read, but finds errors of the device
      if (turn % kTurns != 0) continue;
      const cudaError_t status = cudaEventQuery(written_.get());
      if (status == cudaSuccess) break;
      if (status != cudaErrorNotReady) B3DGS_CUDA_CHECK(status);
      cudaGetLastError();  // otherwise the next launch would report this status
    }
    std::atomic_thread_fence(std::memory_order_acquire);
    return valid(*host_.get());
  }

 private:
  static constexpr std::int64_t kUnwritten = -1;
  PinnedCounts host_;
  Event written_ = make_event();
};

/// A high-priority stream for concurrent passes.
class SideStream {
 public:
  SideStream() {
    int least = 0, greatest = 0;
    cudaStream_t stream = nullptr;
    B3DGS_CUDA_CHECK(cudaDeviceGetStreamPriorityRange(&least, &greatest));
    B3DGS_CUDA_CHECK(cudaStreamCreateWithPriority(&stream, cudaStreamNonBlocking, greatest));
    stream_.reset(stream);
  }
  /// Returns the context for side passes that follow those queued on `main`.
  LaunchContext fork(const LaunchContext& main) {
    order(main.stream, stream_.get());
    LaunchContext side = main;
    side.stream = stream_.get();
    return side;
  }
  /// Makes later passes on `main` follow those on the side stream.
  void join(const LaunchContext& main) { order(stream_.get(), main.stream); }

 private:
  void order(cudaStream_t first, cudaStream_t second) {
    record(reached_, first);
    B3DGS_CUDA_CHECK(cudaStreamWaitEvent(second, reached_.get()));
  }

  Event reached_ = make_event();
  Stream stream_;
};

/// Returns the row of splats that touches the most tiles, for the error about too many pairs. Waits for the device.
inline WidestGaussian widest_gaussian(const ListArgs& lists, const LaunchContext& context) {
  const auto download = [&](const auto* device) {
    std::vector<std::remove_const_t<std::remove_pointer_t<decltype(device)>>> host(
        static_cast<std::size_t>(lists.n_rows));
    B3DGS_CUDA_CHECK(
        cudaMemcpyAsync(host.data(), device, host.size() * sizeof(host[0]), cudaMemcpyDeviceToHost, context.stream));
    B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));
    return host;
  };
  const auto splats = download(lists.projected.splats);
  const auto extents = download(lists.projected.extents);
  const auto radii = download(lists.projected.radii);
  WidestGaussian widest{};
  for (std::size_t i = 0; i < splats.size(); ++i) {
    const std::int32_t n_tiles =
        radii[i] > 0 ? tiles_touched(lists.grid, lists.culling, splats[i], extents[i], radii[i]) : 0;
    if (n_tiles > widest.n_tiles) widest = {splats[i].gaussian, n_tiles};
  }
  return widest;
}

}  // namespace b3dgs::cuda
