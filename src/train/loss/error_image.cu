// The error image, one thread per pixel.

#include "core/cuda_rows.cuh"
#include "train/loss/loss_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) error_image_kernel(const ErrorImageArgs args) {
  const std::int64_t pixel = own_row<kThreads>();
  if (pixel < args.n_pixels) args.error[pixel] = pixel_error(args, pixel);
}

}  // namespace

void compute_error_image(const ErrorImageArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(error_image_kernel, args, args.n_pixels, stream);
}

}  // namespace b3dgs::cuda
