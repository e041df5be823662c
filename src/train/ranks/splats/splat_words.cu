// Splats on their way between ranks: a thread per word to pack them, so that neighbours write side by side, and one per
// row to merge them, or to find the bands that it may touch. No shared memory, no barriers.

#include "core/cuda_rows.cuh"
#include "train/ranks/splats/splat_words_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

struct MergeRowsArgs {
  MergeSplatsArgs merge{};
  std::int64_t n_splats = 0;
};

__global__ void __launch_bounds__(kThreads) pack_splats_kernel(const PackSplatsArgs args) {
  const std::int64_t k = own_row<kThreads>();
  if (k < args.n_packed * kRowWords) pack_splat_word(args, k);
}

__global__ void __launch_bounds__(kThreads) merge_splats_kernel(const MergeRowsArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_splats) merge_splat(args.merge, i);
}

__global__ void __launch_bounds__(kThreads) find_touched_bands_kernel(const TouchBandsArgs args) {
  const std::int64_t m = own_row<kThreads>();
  if (m < args.n_splats) b3dgs::find_touched_bands(args, m);
}

}  // namespace

void pack_splats(const PackSplatsArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(pack_splats_kernel, args, args.n_packed * kRowWords, stream);
}

void merge_splats(const MergeSplatsArgs& args, std::int64_t n_splats, cudaStream_t stream) {
  launch_rows<kThreads>(merge_splats_kernel, MergeRowsArgs{args, n_splats}, n_splats, stream);
}

void find_touched_bands(const TouchBandsArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(find_touched_bands_kernel, args, args.n_splats, stream);
}

}  // namespace b3dgs::cuda
