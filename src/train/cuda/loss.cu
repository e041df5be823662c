// L1 + D-SSIM on the GPU: one kernel for the map, its partial derivatives and the value, one for the gradient. A block
// owns 16 x 16 pixels and filters rows, then columns, in shared memory.

#include "raster/cuda/cuda_check.h"
#include "train/cuda/loss_cuda.h"
#include "train/ssim_window.h"

namespace b3dgs::cuda {
namespace {

constexpr int kSide = 16;
constexpr int kThreads = kSide * kSide;
constexpr int kRadius = kSsimRadius;
constexpr int kHalo = kSide + 2 * kRadius;

/// Weight of tap k of the window. Loops over k are unrolled, so this is an immediate operand.
__device__ __forceinline__ constexpr float window(int k) {
  return ssim_weight(k < kRadius ? kRadius - k : k - kRadius);
}

/// Sums of a block in a fixed order, for thread 0.
__device__ float block_sum(float value, float* scratch) {
  for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(0xffffffffu, value, offset);
  if (threadIdx.x % 32 == 0) scratch[threadIdx.x / 32] = value;
  __syncthreads();  // all warps have written
  float sum = 0;
  if (threadIdx.x == 0) {
    for (int warp = 0; warp < kThreads / 32; ++warp) sum += scratch[warp];
  }
  __syncthreads();  // scratch may be used again
  return sum;
}

/// One channel of both images around the block, invalid and outside pixels 0.
__device__ void load_halo(const LossArgs& args, int channel, float (*rendered)[kHalo], float (*truth)[kHalo]) {
  for (int i = threadIdx.x; i < kHalo * kHalo; i += kThreads) {
    const int x = static_cast<int>(blockIdx.x) * kSide + i % kHalo - kRadius;
    const int y = static_cast<int>(blockIdx.y) * kSide + i / kHalo - kRadius;
    float a = 0, b = 0;
    if (x >= 0 && x < args.width && y >= 0 && y < args.height) {
      const std::int64_t p = static_cast<std::int64_t>(y) * args.width + x;
      if (args.valid == nullptr || args.valid[p] != 0) {
        a = args.rendered[3 * p + channel];
        b = static_cast<float>(args.truth[3 * p + channel]) * (1.0f / 255);
      }
    }
    rendered[i / kHalo][i % kHalo] = a;
    truth[i / kHalo][i % kHalo] = b;
  }
}

/// Partial derivatives of a pixel's SSIM by the three filtered maps that depend on the rendered image.
struct SsimPartials {
  float mean, square, product;
};

/// Per block, sums of |difference| and of SSIM over valid pixels and channels; per pixel and channel, partials.
__global__ void __launch_bounds__(kThreads) loss_map_kernel(const LossArgs args, float* partials, float2* block_sums) {
  __shared__ float rendered[kHalo][kHalo], truth[kHalo][kHalo];
  __shared__ float rows[5][kHalo][kSide];
  __shared__ float scratch[kThreads / 32];
  const int column = static_cast<int>(threadIdx.x) % kSide, row = static_cast<int>(threadIdx.x) / kSide;
  const int x = static_cast<int>(blockIdx.x) * kSide + column, y = static_cast<int>(blockIdx.y) * kSide + row;
  const bool inside = x < args.width && y < args.height;
  const std::int64_t p = static_cast<std::int64_t>(y) * args.width + x;
  const std::int64_t n_pixels = static_cast<std::int64_t>(args.width) * args.height;
  const bool valid = inside && (args.valid == nullptr || args.valid[p] != 0);

  float l1 = 0, ssim = 0;
  for (int channel = 0; channel < 3; ++channel) {
    __syncthreads();  // the last channel has been read
    load_halo(args, channel, rendered, truth);
    __syncthreads();  // this one is complete
    for (int i = threadIdx.x; i < kHalo * kSide; i += kThreads) {
      const int r = i / kSide, c = i % kSide;
      float sums[5] = {0, 0, 0, 0, 0};
#pragma unroll
      for (int k = 0; k <= 2 * kRadius; ++k) {
        const float w = window(k), a = rendered[r][c + k], b = truth[r][c + k];
        sums[0] += w * a;
        sums[1] += w * b;
        sums[2] += w * a * a;
        sums[3] += w * b * b;
        sums[4] += w * a * b;
      }
      for (int m = 0; m < 5; ++m) rows[m][r][c] = sums[m];
    }
    __syncthreads();  // rows are filtered
    float maps[5] = {0, 0, 0, 0, 0};
#pragma unroll
    for (int k = 0; k <= 2 * kRadius; ++k) {
      for (int m = 0; m < 5; ++m) maps[m] += window(k) * rows[m][row + k][column];
    }
    const float mu1 = maps[0], mu2 = maps[1];
    const float variance1 = maps[2] - mu1 * mu1, variance2 = maps[3] - mu2 * mu2, covariance = maps[4] - mu1 * mu2;
    const float a = 2 * mu1 * mu2 + kSsimC1, b = 2 * covariance + kSsimC2;
    const float c = mu1 * mu1 + mu2 * mu2 + kSsimC1, d = variance1 + variance2 + kSsimC2;
    const float inverse = 1 / (c * d), value = a * b * inverse;
    if (valid) {
      l1 += fabsf(rendered[row + kRadius][column + kRadius] - truth[row + kRadius][column + kRadius]);
      ssim += value;
    }
    if (inside && partials != nullptr) {
      const float scale = valid ? 1.0f : 0.0f;
      // The variances and the covariance hold the means too: all ways by which the mean acts, in one.
      partials[(3 * channel) * n_pixels + p] =
          scale * 2 * ((mu2 * (b - a) - value * d * mu1) * inverse + value * mu1 / d);
      partials[(3 * channel + 1) * n_pixels + p] = -scale * value / d;
      partials[(3 * channel + 2) * n_pixels + p] = scale * 2 * a * inverse;
    }
  }
  const float l1_sum = block_sum(l1, scratch), ssim_sum = block_sum(ssim, scratch);
  if (threadIdx.x == 0) block_sums[blockIdx.y * gridDim.x + blockIdx.x] = make_float2(l1_sum, ssim_sum);
}

/// Gradient by the rendered image: the partials filtered once more, and the sign of the difference.
__global__ void __launch_bounds__(kThreads) loss_grad_kernel(const LossArgs args, const float* partials) {
  __shared__ float maps[3][kHalo][kHalo];
  __shared__ float rows[3][kHalo][kSide];
  const int column = static_cast<int>(threadIdx.x) % kSide, row = static_cast<int>(threadIdx.x) / kSide;
  const int x = static_cast<int>(blockIdx.x) * kSide + column, y = static_cast<int>(blockIdx.y) * kSide + row;
  const bool inside = x < args.width && y < args.height;
  const std::int64_t p = static_cast<std::int64_t>(y) * args.width + x;
  const std::int64_t n_pixels = static_cast<std::int64_t>(args.width) * args.height;
  const bool valid = inside && (args.valid == nullptr || args.valid[p] != 0);
  const float per_value = 1.0f / (3.0f * static_cast<float>(args.n_valid));
  const float l1_scale = static_cast<float>(1 - args.lambda_dssim) * per_value;
  const float ssim_scale = -static_cast<float>(args.lambda_dssim) * per_value;

  for (int channel = 0; channel < 3; ++channel) {
    __syncthreads();  // the last channel has been read
    for (int i = threadIdx.x; i < kHalo * kHalo; i += kThreads) {
      const int halo_x = static_cast<int>(blockIdx.x) * kSide + i % kHalo - kRadius;
      const int halo_y = static_cast<int>(blockIdx.y) * kSide + i / kHalo - kRadius;
      const bool in_image = halo_x >= 0 && halo_x < args.width && halo_y >= 0 && halo_y < args.height;
      const std::int64_t q = static_cast<std::int64_t>(halo_y) * args.width + halo_x;
      for (int m = 0; m < 3; ++m) {
        maps[m][i / kHalo][i % kHalo] = in_image ? partials[(3 * channel + m) * n_pixels + q] : 0.0f;
      }
    }
    __syncthreads();  // partials are complete
    for (int i = threadIdx.x; i < kHalo * kSide; i += kThreads) {
      const int r = i / kSide, c = i % kSide;
      for (int m = 0; m < 3; ++m) {
        float sum = 0;
#pragma unroll
        for (int k = 0; k <= 2 * kRadius; ++k) sum += window(k) * maps[m][r][c + k];
        rows[m][r][c] = sum;
      }
    }
    __syncthreads();  // rows are filtered
    SsimPartials sum{0, 0, 0};
#pragma unroll
    for (int k = 0; k <= 2 * kRadius; ++k) {
      sum.mean += window(k) * rows[0][row + k][column];
      sum.square += window(k) * rows[1][row + k][column];
      sum.product += window(k) * rows[2][row + k][column];
    }
    if (!inside) continue;
    float grad = 0;
    if (valid) {
      const float a = args.rendered[3 * p + channel];
      const float b = static_cast<float>(args.truth[3 * p + channel]) * (1.0f / 255);
      const float sign = a > b ? 1.0f : (a < b ? -1.0f : 0.0f);
      grad = ssim_scale * (sum.mean + 2 * a * sum.square + b * sum.product) + l1_scale * sign;
    }
    args.grad[3 * p + channel] = grad;
  }
}

/// Adds up the blocks' sums in a fixed order.
__global__ void __launch_bounds__(kThreads)
    loss_sum_kernel(const LossArgs args, const float2* block_sums, int n_blocks, LossValue* out) {
  __shared__ double l1[kThreads], ssim[kThreads];
  double own_l1 = 0, own_ssim = 0;
  for (int i = threadIdx.x; i < n_blocks; i += kThreads) {
    own_l1 += static_cast<double>(block_sums[i].x);
    own_ssim += static_cast<double>(block_sums[i].y);
  }
  l1[threadIdx.x] = own_l1;
  ssim[threadIdx.x] = own_ssim;
  for (int half = kThreads / 2; half > 0; half /= 2) {
    __syncthreads();  // the larger half is complete
    if (static_cast<int>(threadIdx.x) < half) {
      l1[threadIdx.x] += l1[threadIdx.x + half];
      ssim[threadIdx.x] += ssim[threadIdx.x + half];
    }
  }
  if (threadIdx.x == 0) {
    const double values = 3.0 * static_cast<double>(args.n_valid);
    const double mean_l1 = values > 0 ? l1[0] / values : 0, mean_ssim = values > 0 ? ssim[0] / values : 0;
    *out = {values > 0 ? (1 - args.lambda_dssim) * mean_l1 + args.lambda_dssim * (1 - mean_ssim) : 0, mean_l1,
            mean_ssim};
  }
}

dim3 blocks_of(std::int32_t width, std::int32_t height) {
  return dim3(static_cast<unsigned>((width + kSide - 1) / kSide), static_cast<unsigned>((height + kSide - 1) / kSide));
}

}  // namespace

std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height) {
  const dim3 blocks = blocks_of(width, height);
  return 9 * std::int64_t{width} * height + 2 * std::int64_t{blocks.x} * blocks.y;
}

void compute_loss(const LossArgs& args, LossValue* value, cudaStream_t stream) {
  const dim3 blocks = blocks_of(args.width, args.height);
  auto* const block_sums = reinterpret_cast<float2*>(args.workspace);
  float* const partials = args.workspace + 2 * std::int64_t{blocks.x} * blocks.y;
  loss_map_kernel<<<blocks, kThreads, 0, stream>>>(args, args.grad != nullptr ? partials : nullptr, block_sums);
  B3DGS_CUDA_CHECK_LAUNCH();
  loss_sum_kernel<<<1, kThreads, 0, stream>>>(args, block_sums, static_cast<int>(blocks.x * blocks.y), value);
  B3DGS_CUDA_CHECK_LAUNCH();
  if (args.grad == nullptr) return;
  loss_grad_kernel<<<blocks, kThreads, 0, stream>>>(args, partials);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
