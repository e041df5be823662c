// Strategy balanced, one thread per Gaussian, candidate or part.

#include "core/cuda_check.h"
#include "train/density/strategies/balanced_kernels_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__device__ __forceinline__ std::int64_t own_row() {
  return static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
}

__global__ void __launch_bounds__(kThreads) add_absolute_gradients_kernel(const AbsoluteGradArgs args) {
  if (own_row() < args.n_gaussians) add_absolute_gradient(args, own_row());
}

__global__ void __launch_bounds__(kThreads) draw_parent_keys_kernel(const ParentKeyArgs args) {
  if (own_row() < args.n_rows) draw_parent_key(args, own_row());
}

__global__ void __launch_bounds__(kThreads) make_parts_kernel(const PartArgs args) {
  if (own_row() < 2 * args.n_parents) make_part(args, own_row());
}

template <class Args>
void launch(void (*kernel)(Args), const std::remove_const_t<Args>& args, std::int64_t n, cudaStream_t stream) {
  if (n == 0) return;
  kernel<<<static_cast<unsigned>((n + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void add_absolute_gradients(const AbsoluteGradArgs& args, cudaStream_t stream) {
  launch(add_absolute_gradients_kernel, args, args.n_gaussians, stream);
}
void draw_parent_keys(const ParentKeyArgs& args, cudaStream_t stream) {
  launch(draw_parent_keys_kernel, args, args.n_rows, stream);
}
void make_parts(const PartArgs& args, cudaStream_t stream) {
  launch(make_parts_kernel, args, 2 * args.n_parents, stream);
}

}  // namespace b3dgs::cuda
