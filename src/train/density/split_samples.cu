// Positions of the parts of split Gaussians, one thread per sample: a few thousand every hundred steps.

#include "core/cuda_check.h"
#include "train/density/split_samples_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) split_samples_kernel(const SplitSampleArgs args) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i < args.n_rows) draw_split_sample(args, i);
}

}  // namespace

void draw_split_samples(const SplitSampleArgs& args, cudaStream_t stream) {
  if (args.n_rows == 0) return;
  split_samples_kernel<<<static_cast<unsigned>((args.n_rows + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
