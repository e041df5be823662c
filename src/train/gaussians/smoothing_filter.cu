// The 3D smoothing filter, every hundred steps.
//   Kernel 1: a thread per Gaussian walks all training views; each block takes the largest of its pixel sizes, and adds
//     it to the largest of all with one atomic. Positive floats compare like their bit patterns.
//   Kernel 2: pixel sizes to filters.

#include "core/cuda_rows.cuh"
#include "raster/cuda/warp.cuh"
#include "train/gaussians/smoothing_filter_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) finest_pixel_kernel(const SmoothingFilterArgs args) {
  const std::int64_t i = own_row<kThreads>();
  const float finest = i < args.n_gaussians ? finest_pixel(args, i) : 0;
  if (i < args.n_gaussians) args.filters[i] = finest;
  const int largest = warp_max(__float_as_int(finest));
  if (lane_id() == 0 && largest > 0) atomicMax(reinterpret_cast<int*>(args.largest), largest);
}

__global__ void __launch_bounds__(kThreads) filter_size_kernel(const SmoothingFilterArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_gaussians) args.filters[i] = filter_size(args.filters[i], *args.largest);
}

}  // namespace

void find_finest_pixels(const SmoothingFilterArgs& args, cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.largest, 0, sizeof(float), stream));
  if (args.n_gaussians > 0) launch_rows<kThreads>(finest_pixel_kernel, args, args.n_gaussians, stream);
}

void size_filters(const SmoothingFilterArgs& args, cudaStream_t stream) {
  if (args.n_gaussians > 0) launch_rows<kThreads>(filter_size_kernel, args, args.n_gaussians, stream);
}

}  // namespace b3dgs::cuda
