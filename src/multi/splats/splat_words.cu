// Packing and merging of splats that are exchanged between ranks. Packing has a thread per word, so that neighbouring
// threads write neighbouring words. In merging, each thread first finds the new position of one row and stores it in
// shared memory. After a single barrier, the block copies its rows with a thread per word, so that neighbouring threads
// read and write neighbouring words.

#include "core/cuda_rows.cuh"
#include "multi/splats/splat_words.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

struct MergeRowsArgs {
  MergeSplatsArgs merge{};
  std::int64_t n_splats = 0;
};

__global__ void __launch_bounds__(kThreads) merge_splats_kernel(const MergeRowsArgs args) {
  __shared__ MergedPlace at[kThreads];
  const std::int64_t i = own_row<kThreads>(), first = i - threadIdx.x;
  if (i < args.n_splats) at[threadIdx.x] = merged_place(args.merge, i);
  __syncthreads();
  const int n_here = static_cast<int>(min(static_cast<std::int64_t>(kThreads), args.n_splats - first));
  constexpr int kWords = kRowWords;
  for (int k = static_cast<int>(threadIdx.x); k < n_here * kWords; k += kThreads) {
    merge_word(args.merge, at[k / kWords], k % kWords);
  }
}

}  // namespace

B3DGS_ROW_KERNEL(pack_splat_word, kThreads, PackSplatsArgs)

void merge_splats(const MergeSplatsArgs& args, std::int64_t n_splats, cudaStream_t stream) {
  launch_rows<kThreads>(merge_splats_kernel, MergeRowsArgs{args, n_splats}, n_splats, stream);
}

}  // namespace b3dgs::cuda
