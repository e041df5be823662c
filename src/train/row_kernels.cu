// Kernels with one thread per Gaussian, draw or pixel. What a thread does is in the header of its subject, where CPU
// threads call the same function, so that both devices differ by the rounding of elementary functions at most.

#include "core/cuda_rows.cuh"
#include "raster/cuda/warp.cuh"
#include "train/appearance/exposure.h"
#include "train/density/density_kernels.h"
#include "train/density/strategies/budget_kernels.h"
#include "train/density/strategies/mcmc_math.h"
#include "train/depth/depth_loss.h"
#include "train/gaussians/smoothing_filter_args.h"
#include "train/images/reduce_image.h"
#include "train/loss/loss_args.h"

namespace b3dgs::cuda {

constexpr int kFewThreads = 128, kThreads = 256;  // per block; few where a thread does much

B3DGS_ROW_KERNEL(add_view_row, kThreads, AddViewArgs)
B3DGS_ROW_KERNEL(draw_split_sample, kFewThreads, SplitSampleArgs)
B3DGS_ROW_KERNEL(draw_parent_key, kThreads, ParentKeyArgs)
B3DGS_ROW_KERNEL(make_part, kThreads, PartArgs)
B3DGS_ROW_KERNEL(write_draw_weight, kFewThreads, DrawWeightArgs)
B3DGS_ROW_KERNEL(write_drawn_row, kFewThreads, DrawArgs)
B3DGS_ROW_KERNEL(share_row, kFewThreads, ShareArgs)
B3DGS_ROW_KERNEL(add_noise_row, kFewThreads, MeanNoiseArgs)
B3DGS_ROW_KERNEL(depth_loss_grad_at, kThreads, DepthLossArgs)
B3DGS_ROW_KERNEL(write_pixel_error, kThreads, ErrorImageArgs)
B3DGS_ROW_KERNEL(expose_pixel, kThreads, ExposureArgs)
B3DGS_ROW_KERNEL(reduce_pixel, kFewThreads, ReduceImageArgs)
B3DGS_ROW_KERNEL(write_filter_size, kFewThreads, SmoothingFilterArgs)

namespace {

/// Each warp takes the largest of its pixel sizes; one atomic maximum compares it with that of the others. Positive
/// floats compare like their bit patterns.
__global__ void __launch_bounds__(kFewThreads) finest_pixel_kernel(const SmoothingFilterArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  const float finest = i < args.n_gaussians ? finest_pixel(args, i) : 0;
  if (i < args.n_gaussians) args.filters[i] = finest;
  const int largest = warp_max(__float_as_int(finest));
  if (lane_id() == 0 && largest > 0) atomicMax(reinterpret_cast<int*>(args.largest), largest);
}

}  // namespace

void find_finest_pixels(const SmoothingFilterArgs& args, cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.largest, 0, sizeof(float), stream));
  launch_rows<kFewThreads>(finest_pixel_kernel, args, args.n_gaussians, stream);
}

}  // namespace b3dgs::cuda
