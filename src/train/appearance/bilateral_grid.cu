// The bilateral grid on the GPU.
//   apply      a thread per pixel
//   backward   A block per part of a cell sums what its pixels add to the eight vertices around each of them. A thread
//              has one element of one level, with a sum for each corner of the cell, so that no two threads add to the
//              same sum. Then a thread per element of the grid adds the sums of the cells around its vertex, and a
//              thread per pixel computes the gradient of the rendered image.
//   step       a thread per element

#include "core/cuda_check.h"
#include "train/appearance/bilateral_grid.h"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kParts = 8;  // blocks per cell; the same for all images, so that the order of sums is fixed
constexpr int kCellThreads = kGridLevels * kTransformSize;
constexpr int kColumns = 32, kRows = 8, kThreads = kColumns * kRows;

__global__ void __launch_bounds__(kThreads) apply_grid_kernel(const BilateralGridArgs args) {
  const auto x = static_cast<std::int32_t>(blockIdx.x * kColumns + threadIdx.x),
             y = static_cast<std::int32_t>(blockIdx.y * kRows + threadIdx.y);
  if (x < args.width && y < args.height) correct_pixel(args, x, y);
}

__global__ void __launch_bounds__(kThreads) grid_image_backward_kernel(const BilateralGridArgs args) {
  const auto x = static_cast<std::int32_t>(blockIdx.x * kColumns + threadIdx.x),
             y = static_cast<std::int32_t>(blockIdx.y * kRows + threadIdx.y);
  if (x < args.width && y < args.height) correct_pixel_backward(args, x, y);
}

__global__ void __launch_bounds__(kCellThreads) cell_sums_kernel(const BilateralGridArgs args) {
  // Of one pixel per thread: dL/d(its transform), its weights of the four corners, its place among the levels.
  __shared__ float by_transform[kCellThreads][kTransformSize], by_corner[kCellThreads][4], above[kCellThreads];
  __shared__ int levels[kCellThreads];
  const int cell = static_cast<int>(blockIdx.x), part = static_cast<int>(blockIdx.y);
  const int column = cell % kCellColumns, row = cell / kCellColumns;
  const std::int32_t x_begin = cell_begin(column, kCellColumns, args.width),
                     y_begin = cell_begin(row, kCellRows, args.height);
  const std::int32_t n_x = cell_begin(column + 1, kCellColumns, args.width) - x_begin,
                     n_y = cell_begin(row + 1, kCellRows, args.height) - y_begin;
  const std::int64_t n_pixels = static_cast<std::int64_t>(n_x) * n_y;
  const std::int64_t begin = n_pixels * part / kParts, end = n_pixels * (part + 1) / kParts;
  const int own = static_cast<int>(threadIdx.x), own_level = own / kTransformSize, element = own % kTransformSize;

  float sums[4] = {0, 0, 0, 0};
  for (std::int64_t first = begin; first < end; first += kCellThreads) {
    __syncthreads();  // the pixels before these have been read
    if (first + own < end) {
      const std::int32_t px = x_begin + static_cast<std::int32_t>((first + own) % n_x),
                         py = y_begin + static_cast<std::int32_t>((first + own) / n_x);
      const std::int64_t pixel = static_cast<std::int64_t>(py) * args.width + px;
      const float *color = args.rendered + 3 * pixel, *grad = args.grad + 3 * pixel;
      const GridPlace x = place_of_pixel(px, args.width, kCellColumns), y = place_of_pixel(py, args.height, kCellRows);
      float slope;
      const GridPlace z = place_of_color(color, slope);
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 4; ++k) by_transform[own][4 * i + k] = grad[i] * (k < 3 ? color[k] : 1.0f);
      }
      by_corner[own][0] = (1 - x.part) * (1 - y.part);
      by_corner[own][1] = x.part * (1 - y.part);
      by_corner[own][2] = (1 - x.part) * y.part;
      by_corner[own][3] = x.part * y.part;
      levels[own] = z.index;
      above[own] = z.part;
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
  double* const out = args.cell_sums + (static_cast<std::int64_t>(part) * kCells + cell) * kCellSums;
#pragma unroll
  for (int corner = 0; corner < 4; ++corner) out[corner * kCellThreads + own] = static_cast<double>(sums[corner]);
}

__global__ void __launch_bounds__(kThreads) grid_grad_kernel(const BilateralGridArgs args) {
  const int i = static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  if (i < kGridSize) args.grid_grad[i] = grid_grad(args, kParts, i);
}

__global__ void __launch_bounds__(kThreads) missed_steps_kernel(const AdamArgs adam, const MissedSteps missed) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= adam.n) return;
  float param = adam.param[i], m = adam.m[i], v = adam.v[i];
  for (int step = 0; step < missed.n; ++step) step_one(missed.sizes[step], 0.0f, param, m, v);
  adam.param[i] = param;
  adam.m[i] = m * missed.m_factor;
  adam.v[i] = v * missed.v_factor;
}

__global__ void __launch_bounds__(kThreads) grid_step_kernel(const AdamArgs adam) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i < adam.n) step_one(adam.size, adam.grad[i], adam.param[i], adam.m[i], adam.v[i]);
}

dim3 blocks_of(const BilateralGridArgs& args) {
  return dim3(static_cast<unsigned>((args.width + kColumns - 1) / kColumns),
              static_cast<unsigned>((args.height + kRows - 1) / kRows));
}

unsigned blocks_of(std::int64_t n) {
  return static_cast<unsigned>((n + kThreads - 1) / kThreads);
}

}  // namespace

void apply_bilateral_grid(const BilateralGridArgs& args, cudaStream_t stream) {
  if (args.width == 0 || args.height == 0) return;
  apply_grid_kernel<<<blocks_of(args), dim3(kColumns, kRows), 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

std::int64_t bilateral_grid_sums() {
  return std::int64_t{kParts} * kCells * kCellSums;
}

void bilateral_grid_backward(const BilateralGridArgs& args, cudaStream_t stream) {
  cell_sums_kernel<<<dim3(kCells, kParts), kCellThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  grid_grad_kernel<<<blocks_of(kGridSize), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  if (args.width == 0 || args.height == 0) return;
  grid_image_backward_kernel<<<blocks_of(args), dim3(kColumns, kRows), 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void apply_missed_steps(const AdamArgs& adam, const MissedSteps& missed, cudaStream_t stream) {
  missed_steps_kernel<<<blocks_of(adam.n), kThreads, 0, stream>>>(adam, missed);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void bilateral_grid_step(const AdamArgs& adam, cudaStream_t stream) {
  grid_step_kernel<<<blocks_of(adam.n), kThreads, 0, stream>>>(adam);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
