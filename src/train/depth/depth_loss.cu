// The gradient of the depth loss, one thread per pixel.

#include "core/cuda_check.h"
#include "train/depth/depth_loss_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) depth_loss_kernel(const __grid_constant__ DepthLossArgs args) {
  const std::int64_t pixel = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (pixel < std::int64_t{args.width} * args.height) depth_loss_grad_at(args, pixel);
}

}  // namespace

void depth_loss_gradient(const DepthLossArgs& args, cudaStream_t stream) {
  const std::int64_t n = std::int64_t{args.width} * args.height;
  depth_loss_kernel<<<static_cast<unsigned>((n + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
