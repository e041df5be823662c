// The area filter, one thread per reduced pixel: it reads the photograph once, a few microseconds.

#include "core/cuda_check.h"
#include "train/images/reduce_image_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) reduce_image_kernel(const ReduceImageArgs args) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  const std::int32_t width = args.reduced_width();
  if (i >= std::int64_t{width} * args.reduced_height()) return;
  reduce_pixel(args, static_cast<std::int32_t>(i % width), static_cast<std::int32_t>(i / width));
}

}  // namespace

void reduce_image(const ReduceImageArgs& args, cudaStream_t stream) {
  const std::int64_t n = std::int64_t{args.reduced_width()} * args.reduced_height();
  if (n == 0) return;
  reduce_image_kernel<<<static_cast<unsigned>((n + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
