// Positions of the parts of split Gaussians, one thread per sample: a few thousand every hundred steps.

#include "core/cuda_rows.cuh"
#include "train/density/split_samples_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) split_samples_kernel(const SplitSampleArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_rows) draw_split_sample(args, i);
}

}  // namespace

void draw_split_samples(const SplitSampleArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(split_samples_kernel, args, args.n_rows, stream);
}

}  // namespace b3dgs::cuda
