// Strategy budget, one thread per Gaussian, candidate or part.

#include "core/cuda_rows.cuh"
#include "train/density/strategies/budget_kernels_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) draw_parent_keys_kernel(const ParentKeyArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_rows) draw_parent_key(args, i);
}

__global__ void __launch_bounds__(kThreads) make_parts_kernel(const PartArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < 2 * args.n_parents) make_part(args, i);
}

}  // namespace

void draw_parent_keys(const ParentKeyArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(draw_parent_keys_kernel, args, args.n_rows, stream);
}
void make_parts(const PartArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(make_parts_kernel, args, 2 * args.n_parents, stream);
}

}  // namespace b3dgs::cuda
