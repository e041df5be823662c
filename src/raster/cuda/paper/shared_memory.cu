// (s) shared-memory, to which the paper's training switches at the inflection point: naive with colours and depths also
// staged in shared memory, so that a contributing splat needs no access to global memory.

#include "raster/cuda/paper/pixel_wise.cuh"

namespace b3dgs::cuda {
namespace {

/// All data that blending needs.
struct StagedColors : StagedShapes {
  float4 colors[kPatchThreads];  // red, green, blue, depth

  __device__ __forceinline__ void stage(const Splat* splats, std::int32_t splat) {
    StagedShapes::stage(splats, splat);
    const float4 color = load_color(splats, splat);
    colors[threadIdx.x] = make_float4(color.x, color.y, color.z, load_mean(splats, splat).w);
  }
  __device__ __forceinline__ float4 color_depth(const Splat* /*splats*/, int j) const { return colors[j]; }
};

__global__ void __launch_bounds__(kPatchThreads) shared_memory_kernel(const PaperArgs args) {
  __shared__ StagedColors batch;
  note_start(args);
  blend_patch(args.blend, batch, static_cast<std::int32_t>(blockIdx.x));
  note_end(args);
}

}  // namespace

PaperKernel paper_shared_memory() {
  return {shared_memory_kernel, /*takes_tasks=*/false};
}

}  // namespace b3dgs::cuda
