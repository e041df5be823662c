// The error image, one thread per pixel.

#include "core/cuda_check.h"
#include "train/loss/loss_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) error_image_kernel(const ErrorImageArgs args) {
  const std::int64_t pixel = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (pixel < args.n_pixels) args.error[pixel] = pixel_error(args, pixel);
}

}  // namespace

void compute_error_image(const ErrorImageArgs& args, cudaStream_t stream) {
  if (args.n_pixels == 0) return;
  error_image_kernel<<<static_cast<unsigned>((args.n_pixels + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
