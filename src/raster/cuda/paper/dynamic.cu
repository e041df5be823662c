// (b) dynamic, the paper's inter-block dynamic workload distribution (Algorithm 3): the body of naive inside a loop. As
// many blocks as are resident at once take patches from an atomic counter until none is left. The hardware distributes
// the blocks of naive in nearly the same way, so the gain is small. A patch that costs more than a block's fair share
// still determines the time.

#include "raster/cuda/paper/pixel_wise.cuh"

namespace b3dgs::cuda {
namespace {

__global__ void __launch_bounds__(kPatchThreads) dynamic_kernel(const PaperArgs args) {
  __shared__ StagedShapes batch;
  __shared__ std::int32_t patch;
  note_start(args);
  while (true) {
    __syncthreads();  // all threads have read the previous patch number
    if (threadIdx.x == 0) patch = atomicAdd(args.next_task, 1);
    __syncthreads();
    if (patch >= args.blend.grid.n_tiles()) break;
    blend_patch(args.blend, batch, patch);
  }
  note_end(args);
}

}  // namespace

PaperKernel paper_dynamic() {
  return {dynamic_kernel, /*takes_tasks=*/true};
}

}  // namespace b3dgs::cuda
