// Kernels with one thread per Gaussian, draw or pixel. What a thread does is in the header of its subject, where CPU
// threads call the same function (for_rows() in core/parallel.h), so that both devices differ by the rounding of
// elementary functions at most. Only the largest of the finest pixels is found in another way on a CPU.

#include "core/cuda_rows.cuh"
#include "raster/cuda/warp.cuh"
#include "train/density/density_kernels.h"
#include "train/density/strategies/mcmc_math.h"
#include "train/depth/depth_loss.h"
#include "train/gaussians/smoothing_filter_args.h"
#include "train/images/reduce_image.h"
#include "train/loss/loss_args.h"

namespace b3dgs::cuda {
namespace {

constexpr int kFewThreads = 128, kThreads = 256;  // per block; few where a thread does much

__global__ void __launch_bounds__(kThreads) add_view_kernel(const AddViewArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_gaussians) add_view_row(args, i);
}

__global__ void __launch_bounds__(kFewThreads) split_samples_kernel(const SplitSampleArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_rows) draw_split_sample(args, i);
}

__global__ void __launch_bounds__(kFewThreads) draw_weights_kernel(const DrawWeightArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_rows) write_draw_weight(args, i);
}

__global__ void __launch_bounds__(kFewThreads) draw_rows_kernel(const DrawArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_draws) write_drawn_row(args, i);
}

__global__ void __launch_bounds__(kFewThreads) share_rows_kernel(const ShareArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_rows) share_row(args, i);
}

__global__ void __launch_bounds__(kFewThreads) mean_noise_kernel(const MeanNoiseArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_gaussians) add_noise_row(args, i);
}

__global__ void __launch_bounds__(kThreads) depth_loss_kernel(const __grid_constant__ DepthLossArgs args) {
  const std::int64_t pixel = own_row<kThreads>();
  if (pixel < std::int64_t{args.width} * args.height) depth_loss_grad_at(args, pixel);
}

__global__ void __launch_bounds__(kThreads) error_image_kernel(const ErrorImageArgs args) {
  const std::int64_t pixel = own_row<kThreads>();
  if (pixel < args.n_pixels) write_pixel_error(args, pixel);
}

__global__ void __launch_bounds__(kFewThreads) reduce_image_kernel(const ReduceImageArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  const std::int32_t width = args.reduced_width();
  if (i >= std::int64_t{width} * args.reduced_height()) return;
  reduce_pixel(args, static_cast<std::int32_t>(i % width), static_cast<std::int32_t>(i / width));
}

/// Each warp takes the largest of its pixel sizes; one atomic maximum compares it with that of the others. Positive
/// floats compare like their bit patterns.
__global__ void __launch_bounds__(kFewThreads) finest_pixel_kernel(const SmoothingFilterArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  const float finest = i < args.n_gaussians ? finest_pixel(args, i) : 0;
  if (i < args.n_gaussians) args.filters[i] = finest;
  const int largest = warp_max(__float_as_int(finest));
  if (lane_id() == 0 && largest > 0) atomicMax(reinterpret_cast<int*>(args.largest), largest);
}

__global__ void __launch_bounds__(kFewThreads) filter_size_kernel(const SmoothingFilterArgs args) {
  const std::int64_t i = own_row<kFewThreads>();
  if (i < args.n_gaussians) args.filters[i] = filter_size(args.filters[i], *args.largest);
}

}  // namespace

void add_view(const AddViewArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(add_view_kernel, args, args.n_gaussians, stream);
}

void draw_split_samples(const SplitSampleArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(split_samples_kernel, args, args.n_rows, stream);
}

void compute_draw_weights(const DrawWeightArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(draw_weights_kernel, args, args.n_rows, stream);
}

void draw_rows(const DrawArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(draw_rows_kernel, args, args.n_draws, stream);
}

void share_rows(const ShareArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(share_rows_kernel, args, args.n_rows, stream);
}

void add_mean_noise(const MeanNoiseArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(mean_noise_kernel, args, args.n_gaussians, stream);
}

void depth_loss_gradient(const DepthLossArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(depth_loss_kernel, args, std::int64_t{args.width} * args.height, stream);
}

void compute_error_image(const ErrorImageArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(error_image_kernel, args, args.n_pixels, stream);
}

void reduce_image(const ReduceImageArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(reduce_image_kernel, args, std::int64_t{args.reduced_width()} * args.reduced_height(),
                           stream);
}

void find_finest_pixels(const SmoothingFilterArgs& args, cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.largest, 0, sizeof(float), stream));
  launch_rows<kFewThreads>(finest_pixel_kernel, args, args.n_gaussians, stream);
}

void size_filters(const SmoothingFilterArgs& args, cudaStream_t stream) {
  launch_rows<kFewThreads>(filter_size_kernel, args, args.n_gaussians, stream);
}

}  // namespace b3dgs::cuda
