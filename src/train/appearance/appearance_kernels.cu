// The appearance model on the GPU. Kernels with a thread per pixel or per element of a grid are in row_kernels.cu.

#include "core/cuda_rows.cuh"
#include "train/appearance/appearance_kernels.h"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32;
constexpr int kCellThreads = kGridLevels * kTransformSize;

template <class Real>
__device__ __forceinline__ Real sum_warp(Real value) {
  for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(0xffffffffu, value, offset);
  return value;
}

/// Sums the gradient of the transform over kExposureBlock pixels per block.
__global__ void __launch_bounds__(kThreads) exposure_backward_kernel(const AppearanceArgs args) {
  __shared__ float of_warp[kWarps][kTransformSize];
  float sums[kTransformSize] = {};
  const std::int64_t begin = static_cast<std::int64_t>(blockIdx.x) * kExposureBlock;
  const std::int64_t end = begin + kExposureBlock < args.n_pixels() ? begin + kExposureBlock : args.n_pixels();
  for (std::int64_t pixel = begin + threadIdx.x; pixel < end; pixel += kThreads) {
    expose_pixel_backward(args, pixel, sums);
  }
#pragma unroll
  for (int k = 0; k < kTransformSize; ++k) {
    const float sum = sum_warp(sums[k]);
    if (threadIdx.x % 32 == 0) of_warp[threadIdx.x / 32][k] = sum;
  }
  __syncthreads();  // all warps have written
  if (threadIdx.x >= kTransformSize) return;
  double sum = 0;
  for (int warp = 0; warp < kWarps; ++warp) sum += static_cast<double>(of_warp[warp][threadIdx.x]);
  args.sums[static_cast<std::int64_t>(blockIdx.x) * kTransformSize + threadIdx.x] = sum;
}

/// Adds the sums of all blocks, with one warp per element of the transform.
__global__ void __launch_bounds__(32 * kTransformSize) exposure_sum_kernel(const AppearanceArgs args) {
  const int element = static_cast<int>(threadIdx.x) / 32, lane = static_cast<int>(threadIdx.x) % 32;
  double sum = 0;
  for (std::int64_t block = lane; block < exposure_blocks(args); block += 32) {
    sum += args.sums[block * kTransformSize + element];
  }
  sum = sum_warp(sum);
  if (lane == 0) args.transform_grad[element] = static_cast<float>(sum);
}

/// Sums the contributions of the pixels in a part of a cell to the eight vertices around each pixel, with one block per
/// part. A thread has one element of one level, with a sum for each corner of the cell, so that no two threads add to
/// the same sum.
__global__ void __launch_bounds__(kCellThreads) cell_sums_kernel(const AppearanceArgs args) {
  // For the pixel of each thread: dL/d(its transform), the weights of its four corners, its position between two
  // levels.
  __shared__ float by_transform[kCellThreads][kTransformSize], by_corner[kCellThreads][4], above[kCellThreads];
  __shared__ int levels[kCellThreads];
  const int cell = static_cast<int>(blockIdx.x), part = static_cast<int>(blockIdx.y);
  const int column = cell % kCellColumns, row = cell / kCellColumns;
  const std::int32_t x_begin = cell_begin(column, kCellColumns, args.width),
                     y_begin = cell_begin(row, kCellRows, args.height);
  const std::int32_t n_x = cell_begin(column + 1, kCellColumns, args.width) - x_begin,
                     n_y = cell_begin(row + 1, kCellRows, args.height) - y_begin;
  const std::int64_t n_pixels = static_cast<std::int64_t>(n_x) * n_y;
  const std::int64_t begin = n_pixels * part / kCellParts, end = n_pixels * (part + 1) / kCellParts;
  const int own = static_cast<int>(threadIdx.x), own_level = own / kTransformSize, element = own % kTransformSize;

  float sums[4] = {0, 0, 0, 0};
  for (std::int64_t first = begin; first < end; first += kCellThreads) {
    __syncthreads();  // the pixels before these have been read
    if (first + own < end) {
      const std::int32_t px = x_begin + static_cast<std::int32_t>((first + own) % n_x),
                         py = y_begin + static_cast<std::int32_t>((first + own) / n_x);
      const std::int64_t pixel = static_cast<std::int64_t>(py) * args.width + px;
      const float *color = args.rendered + 3 * pixel, *grad = args.grad + 3 * pixel;
      const PixelPlace at = place_in_grid(args, pixel);
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 4; ++k) by_transform[own][4 * i + k] = grad[i] * (k < 3 ? color[k] : 1.0f);
      }
      by_corner[own][0] = (1 - at.x.part) * (1 - at.y.part);
      by_corner[own][1] = at.x.part * (1 - at.y.part);
      by_corner[own][2] = (1 - at.x.part) * at.y.part;
      by_corner[own][3] = at.x.part * at.y.part;
      levels[own] = at.z.index;
      above[own] = at.z.part;
    }
    __syncthreads();  // the pixels are loaded
    const int n = end - first < kCellThreads ? static_cast<int>(end - first) : kCellThreads;
    for (int j = 0; j < n; ++j) {
      const int level = levels[j];
      if (own_level != level && own_level != level + 1) continue;
      const float value = (own_level == level ? 1 - above[j] : above[j]) * by_transform[j][element];
#pragma unroll
      for (int corner = 0; corner < 4; ++corner) sums[corner] += value * by_corner[j][corner];
    }
  }
  double* const out = args.sums + (static_cast<std::int64_t>(part) * kCells + cell) * kCellSums;
#pragma unroll
  for (int corner = 0; corner < 4; ++corner) out[corner * kCellThreads + own] = static_cast<double>(sums[corner]);
}

__global__ void __launch_bounds__(kThreads) appearance_step_kernel(const AppearanceStepArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= args.adam.n) return;
  const bool has_grad = i >= args.first && i < args.first + args.n_grads;
  const float grad = has_grad ? args.transform_grad[i - args.first] : 0.0f;
  step_one(args.adam.size, grad, args.adam.param[i], args.adam.m[i], args.adam.v[i]);
}

/// Subtracts mean_excess() from all exposures, with one warp per element of a transform.
__global__ void __launch_bounds__(32 * kTransformSize) center_exposures_kernel(const AdamArgs exposures) {
  const int element = static_cast<int>(threadIdx.x) / 32, lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t n_views = exposures.n / kTransformSize;
  double sum = 0;
  for (std::int64_t view = lane; view < n_views; view += 32) {
    sum += static_cast<double>(exposures.param[view * kTransformSize + element]);
  }
  const float excess = mean_excess(exposures, element, sum_warp(sum));
  for (std::int64_t view = lane; view < n_views; view += 32) exposures.param[view * kTransformSize + element] -= excess;
}

__global__ void __launch_bounds__(kThreads) missed_steps_kernel(const MissedSteps missed) {
  const AdamArgs& adam = missed.adam;
  const std::int64_t i = own_row<kThreads>();
  if (i >= adam.n) return;
  float param = adam.param[i], m = adam.m[i], v = adam.v[i];
  for (int step = 0; step < missed.n; ++step) step_one(missed.sizes[step], 0.0f, param, m, v);
  adam.param[i] = param;
  adam.m[i] = m * missed.m_factor;
  adam.v[i] = v * missed.v_factor;
}

}  // namespace

void exposure_backward(const AppearanceArgs& args, cudaStream_t stream) {
  if (args.n_pixels() > 0) {
    exposure_backward_kernel<<<static_cast<unsigned>(exposure_blocks(args)), kThreads, 0, stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  }
  exposure_sum_kernel<<<1, 32 * kTransformSize, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void sum_cells(const AppearanceArgs& args, cudaStream_t stream) {
  cell_sums_kernel<<<dim3(kCells, kCellParts), kCellThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void appearance_step(const AppearanceStepArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(appearance_step_kernel, args, args.adam.n, stream);
}

void center_exposures(const AdamArgs& exposures, cudaStream_t stream) {
  if (exposures.n == 0) return;
  center_exposures_kernel<<<1, 32 * kTransformSize, 0, stream>>>(exposures);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void apply_missed_steps(const MissedSteps& missed, cudaStream_t stream) {
  launch_rows<kThreads>(missed_steps_kernel, missed, missed.adam.n, stream);
}

}  // namespace b3dgs::cuda
