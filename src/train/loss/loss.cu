// L1 + D-SSIM on the GPU. The first kernel computes SSIM's partial derivatives and the sums of each block, and the
// second one the gradient and the value. A block owns one channel of 32 x 32 pixels and filters rows, then columns, in
// shared memory. Loads from shared memory limit the speed, so a thread filters four adjacent outputs at once, with 14
// loads for 44 products.
//
//   1st kernel   rendered, truth  ->  four maps, filtered  ->  three partial derivatives of SSIM, sums of blocks
//   2nd kernel   partial derivatives  ->  filtered  ->  gradient of the rendered image; block 0: value

#include "core/cuda_check.h"
#include "train/loss/loss_args.h"

namespace b3dgs::cuda {
namespace {

constexpr int kSide = 32;
constexpr int kThreads = 256;
constexpr int kBlocks = 4;  // blocks resident per multiprocessor, which limits the registers
constexpr int kRadius = kSsimRadius;
constexpr int kHalo = kSide + 2 * kRadius;
constexpr int kRun = 4;  // number of adjacent outputs that a thread filters at once
static_assert(kSide * kSide == kRun * kThreads, "one run of a column per thread");
constexpr int kRunInputs = kRun + 2 * kRadius;

/// Row length in floats, rounded up so that rows start at multiples of 16 bytes.
constexpr int kPitch = (kHalo + 3) / 4 * 4;
using HaloPlane = float[kHalo][kPitch];
using RowPlane = float[kHalo][kSide];

/// Returns the weight of tap k of the window. Loops over k are unrolled, so this is an immediate operand.
__device__ __forceinline__ constexpr float window(int k) {
  return ssim_weight(k < kRadius ? kRadius - k : k - kRadius);
}

struct Run {
  float of[kRun];
};

__device__ __forceinline__ Run filter_run(const float (&in)[kRunInputs]) {
  Run run{};
#pragma unroll
  for (int j = 0; j < kRun; ++j) {
#pragma unroll
    for (int k = 0; k <= 2 * kRadius; ++k) run.of[j] += window(k) * in[j + k];
  }
  return run;
}

/// Loads the inputs of a run in a row. `from` is aligned to 16 bytes.
__device__ __forceinline__ void load_run(const float* from, float (&in)[kRunInputs]) {
  static_assert(kRunInputs % 4 == 2, "loads of four floats, then one of two");
#pragma unroll
  for (int k = 0; k + 4 <= kRunInputs; k += 4) {
    const float4 four = *reinterpret_cast<const float4*>(from + k);
    in[k] = four.x;
    in[k + 1] = four.y;
    in[k + 2] = four.z;
    in[k + 3] = four.w;
  }
  const float2 two = *reinterpret_cast<const float2*>(from + kRunInputs - 2);
  in[kRunInputs - 2] = two.x;
  in[kRunInputs - 1] = two.y;
}

__device__ __forceinline__ void store_run(float* to, const Run& run) {
  *reinterpret_cast<float4*>(to) = make_float4(run.of[0], run.of[1], run.of[2], run.of[3]);
}

/// Filters the thread's run of a column of filtered rows.
__device__ __forceinline__ Run filter_column(const RowPlane& rows, int first_row, int column) {
  float in[kRunInputs];
#pragma unroll
  for (int k = 0; k < kRunInputs; ++k) in[k] = rows[first_row + k][column];
  return filter_run(in);
}

/// Calls body(row, column) with the first pixel of each run in each row of the halo.
template <class Body>
__device__ __forceinline__ void for_row_runs(Body&& body) {
  constexpr int kRuns = kSide / kRun;
  for (int i = static_cast<int>(threadIdx.x); i < kHalo * kRuns; i += kThreads) body(i / kRuns, i % kRuns * kRun);
}

/// The channel and tile of a block. The three blocks of a tile are consecutive, so that its cache lines are loaded
/// once.
struct ChannelTile {
  int channel;
  int x, y;  // position of the first pixel, px
};

__device__ __forceinline__ ChannelTile channel_tile(const LossArgs& args, unsigned block) {
  const unsigned n_columns = (static_cast<unsigned>(args.width) + kSide - 1) / kSide, tile = block / 3;
  return {static_cast<int>(block % 3), static_cast<int>(tile % n_columns) * kSide,
          static_cast<int>(tile / n_columns) * kSide};
}

/// Calls body(row, column, pixel) for each pixel of the halo, where pixel is -1 outside the image.
template <class Body>
__device__ __forceinline__ void for_halo(const LossArgs& args, const ChannelTile& tile, Body&& body) {
#pragma unroll 4
  for (int i = static_cast<int>(threadIdx.x); i < kHalo * kHalo; i += kThreads) {
    const int row = i / kHalo, column = i % kHalo;
    const int x = tile.x + column - kRadius, y = tile.y + row - kRadius;
    const bool inside = x >= 0 && x < args.width && y >= 0 && y < args.height;
    body(row, column, inside ? static_cast<std::int64_t>(y) * args.width + x : -1);
  }
}

/// Returns the sum over a block to thread 0, added in a fixed order.
template <class Real>
__device__ Real block_sum(Real value, Real* scratch) {
  for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(0xffffffffu, value, offset);
  if (threadIdx.x % 32 == 0) scratch[threadIdx.x / 32] = value;
  __syncthreads();  // all warps have written
  Real sum = 0;
  if (threadIdx.x == 0) {
    for (int warp = 0; warp < kThreads / 32; ++warp) sum += scratch[warp];
  }
  __syncthreads();  // scratch may be used again
  return sum;
}

__device__ __forceinline__ float truth_of(const LossArgs& args, std::int64_t p, int channel) {
  return static_cast<float>(args.truth[3 * p + channel]) * (1.0f / 255);
}

/// Sums of |rendered - truth| and of SSIM over a block's valid pixels.
struct BlockLoss {
  float l1 = 0, ssim = 0;
};

constexpr int kMaps = 4;  // rendered, truth, the sum of their squares, their product

/// Returns the SSIM of one channel of a pixel, given the filtered maps. `partials` points to the pixel's element in
/// planes of n_pixels. It receives the derivatives with respect to the three maps that depend on the rendered image,
/// times `scale`.
__device__ __forceinline__ float ssim_of(const float (&maps)[kMaps], float scale, float* partials,
                                         std::int64_t n_pixels) {
  const float mu1 = maps[0], mu2 = maps[1], means_squared = mu1 * mu1 + mu2 * mu2, covariance = maps[3] - mu1 * mu2;
  const float a = 2 * mu1 * mu2 + kSsimC1, b = 2 * covariance + kSsimC2;
  const float c = means_squared + kSsimC1, d = maps[2] - means_squared + kSsimC2;
  const float inverse = 1 / (c * d), value = a * b * inverse, inverse_d = c * inverse;
  // This is the total derivative with respect to the mean, because variance and covariance depend on the mean, too.
  partials[0] = scale * 2 * ((mu2 * (b - a) - value * d * mu1) * inverse + value * mu1 * inverse_d);
  partials[n_pixels] = -scale * value * inverse_d;
  partials[2 * n_pixels] = scale * 2 * a * inverse;
  return value;
}

/// Writes the sums of each block and the partial derivatives of each pixel and channel.
__global__ void __launch_bounds__(kThreads, kBlocks)
    loss_map_kernel(const LossArgs args, float* partials, BlockLoss* sums) {
  __shared__ alignas(16) HaloPlane rendered, truth;  // 0 at invalid pixels and outside the image
  __shared__ alignas(16) RowPlane rows[kMaps];
  __shared__ float scratch[kThreads / 32];
  const ChannelTile tile = channel_tile(args, blockIdx.x);
  const int column = static_cast<int>(threadIdx.x) % kSide, first_row = static_cast<int>(threadIdx.x) / kSide * kRun;
  const std::int64_t n_pixels = static_cast<std::int64_t>(args.width) * args.height;

  for_halo(args, tile, [&](int row, int halo_column, std::int64_t p) {
    const bool valid = p >= 0 && (args.valid == nullptr || args.valid[p] != 0);
    rendered[row][halo_column] = valid ? args.rendered[3 * p + tile.channel] : 0.0f;
    truth[row][halo_column] = valid ? truth_of(args, p, tile.channel) : 0.0f;
  });
  __syncthreads();  // the images are loaded
  for_row_runs([&](int row, int first_column) {
    float a[kRunInputs], b[kRunInputs], product[kRunInputs];
    load_run(rendered[row] + first_column, a);
    load_run(truth[row] + first_column, b);
    store_run(rows[0][row] + first_column, filter_run(a));
    store_run(rows[1][row] + first_column, filter_run(b));
#pragma unroll
    for (int k = 0; k < kRunInputs; ++k) product[k] = a[k] * b[k];
    store_run(rows[3][row] + first_column, filter_run(product));
#pragma unroll
    for (int k = 0; k < kRunInputs; ++k) product[k] = a[k] * a[k] + b[k] * b[k];
    store_run(rows[2][row] + first_column, filter_run(product));
  });
  __syncthreads();  // rows are filtered
  Run maps[kMaps];
#pragma unroll
  for (int m = 0; m < kMaps; ++m) maps[m] = filter_column(rows[m], first_row, column);
  BlockLoss own;
#pragma unroll
  for (int j = 0; j < kRun; ++j) {
    const int x = tile.x + column, y = tile.y + first_row + j;
    if (x >= args.width || y >= args.height) continue;
    const std::int64_t p = static_cast<std::int64_t>(y) * args.width + x;
    const bool valid = args.valid == nullptr || args.valid[p] != 0;
    const float of_pixel[kMaps] = {maps[0].of[j], maps[1].of[j], maps[2].of[j], maps[3].of[j]};
    const float ssim = ssim_of(of_pixel, valid ? 1.0f : 0.0f, partials + 3 * tile.channel * n_pixels + p, n_pixels);
    if (!valid) continue;
    const int r = first_row + j + kRadius, c = column + kRadius;
    own.l1 += fabsf(rendered[r][c] - truth[r][c]);
    own.ssim += ssim;
  }
  const BlockLoss sum{block_sum(own.l1, scratch), block_sum(own.ssim, scratch)};
  if (threadIdx.x == 0) sums[blockIdx.x] = sum;
}

/// Adds up the sums of all blocks in a fixed order. One block calls this.
__device__ void sum_loss(const LossArgs& args, const BlockLoss* sums, int n_blocks, double* scratch, LossValue* out) {
  double own_l1 = 0, own_ssim = 0;
  for (int i = static_cast<int>(threadIdx.x); i < n_blocks; i += kThreads) {
    own_l1 += static_cast<double>(sums[i].l1);
    own_ssim += static_cast<double>(sums[i].ssim);
  }
  const double l1 = block_sum(own_l1, scratch), ssim = block_sum(own_ssim, scratch);
  if (threadIdx.x > 0) return;
  const double values = 3.0 * static_cast<double>(args.n_valid);
  const double mean_l1 = values > 0 ? l1 / values : 0, mean_ssim = values > 0 ? ssim / values : 0;
  *out = values > 0 ? weighted_loss(args.weights, mean_l1, mean_ssim) : LossValue{};
}

/// Computes the gradient with respect to the rendered image, by filtering the partial derivatives again and adding the
/// slope of L1. The first block computes the value at the same time.
__global__ void __launch_bounds__(kThreads, kBlocks)
    loss_grad_kernel(const LossArgs args, const float* partials, const BlockLoss* sums, LossValue* value) {
  __shared__ alignas(16) HaloPlane maps[3];
  __shared__ alignas(16) RowPlane rows[3];
  __shared__ double scratch[kThreads / 32];
  if (blockIdx.x == 0) return sum_loss(args, sums, static_cast<int>(gridDim.x) - 1, scratch, value);
  const ChannelTile tile = channel_tile(args, blockIdx.x - 1);
  const int column = static_cast<int>(threadIdx.x) % kSide, first_row = static_cast<int>(threadIdx.x) / kSide * kRun;
  const std::int64_t n_pixels = static_cast<std::int64_t>(args.width) * args.height;
  const LossScales scales = loss_scales(args);

  for_halo(args, tile, [&](int row, int halo_column, std::int64_t p) {
#pragma unroll
    for (int m = 0; m < 3; ++m) {
      maps[m][row][halo_column] = p >= 0 ? partials[(3 * tile.channel + m) * n_pixels + p] : 0.0f;
    }
  });
  __syncthreads();  // the partials are loaded
  for_row_runs([&](int row, int first_column) {
#pragma unroll
    for (int m = 0; m < 3; ++m) {
      float in[kRunInputs];
      load_run(maps[m][row] + first_column, in);
      store_run(rows[m][row] + first_column, filter_run(in));
    }
  });
  __syncthreads();  // rows are filtered
  const Run mean = filter_column(rows[0], first_row, column), square = filter_column(rows[1], first_row, column),
            product = filter_column(rows[2], first_row, column);
#pragma unroll
  for (int j = 0; j < kRun; ++j) {
    const int x = tile.x + column, y = tile.y + first_row + j;
    if (x >= args.width || y >= args.height) continue;
    const std::int64_t p = static_cast<std::int64_t>(y) * args.width + x;
    float grad = 0;
    if (args.valid == nullptr || args.valid[p] != 0) {
      const float a = args.rendered[3 * p + tile.channel], b = truth_of(args, p, tile.channel);
      const float sign = a > b ? 1.0f : (a < b ? -1.0f : 0.0f);
      grad = scales.ssim * (mean.of[j] + 2 * a * square.of[j] + b * product.of[j]) + scales.l1 * sign;
    }
    args.grad[3 * p + tile.channel] = grad;
  }
}

/// Returns the number of blocks, one for each channel of each tile.
unsigned n_blocks_of(std::int32_t width, std::int32_t height) {
  return 3 * static_cast<unsigned>((width + kSide - 1) / kSide) * static_cast<unsigned>((height + kSide - 1) / kSide);
}

}  // namespace

std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height) {
  return 9 * std::int64_t{width} * height + 2 * std::int64_t{n_blocks_of(width, height)};
}

void compute_loss(const LossArgs& args, LossValue* value, cudaStream_t stream) {
  const unsigned n_blocks = n_blocks_of(args.width, args.height);
  auto* const sums = reinterpret_cast<BlockLoss*>(args.workspace);
  float* const partials = args.workspace + 2 * std::int64_t{n_blocks};
  loss_map_kernel<<<n_blocks, kThreads, 0, stream>>>(args, partials, sums);
  B3DGS_CUDA_CHECK_LAUNCH();
  loss_grad_kernel<<<n_blocks + 1, kThreads, 0, stream>>>(args, partials, sums, value);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
