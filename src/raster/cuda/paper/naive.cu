// (a) naive, the paper's baseline (Algorithm 1): a block of 128 threads per patch of 16 x 8 px, a thread per pixel. A
// block runs as long as its slowest pixel, and the launch as long as its most crowded patch.

#include "raster/cuda/paper/pixel_wise.cuh"

namespace b3dgs::cuda {
namespace {

__global__ void __launch_bounds__(kPatchThreads) naive_kernel(const PaperArgs args) {
  __shared__ StagedShapes batch;
  note_start(args);
  blend_patch(args.blend, batch, static_cast<std::int32_t>(blockIdx.x));
  note_end(args);
}

}  // namespace

PaperKernel paper_naive() {
  return {naive_kernel, /*takes_tasks=*/false};
}

}  // namespace b3dgs::cuda
