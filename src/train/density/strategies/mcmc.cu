// Strategy mcmc on the GPU: one thread per Gaussian or draw.

#include "core/cuda_rows.cuh"
#include "train/density/strategies/mcmc_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) draw_weights_kernel(const DrawWeightArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_rows) args.out[i] = draw_weight(args.logit_opacities[i], args.dead_logit);
}

__global__ void __launch_bounds__(kThreads) draw_rows_kernel(const DrawArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_draws) args.out[i] = draw_row(args, i);
}

__global__ void __launch_bounds__(kThreads) share_rows_kernel(const ShareArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_rows) share_row(args, i);
}

__global__ void __launch_bounds__(kThreads) mean_noise_kernel(const MeanNoiseArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_gaussians) b3dgs::add_mean_noise(args, i);
}

}  // namespace

void compute_draw_weights(const DrawWeightArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(draw_weights_kernel, args, args.n_rows, stream);
}

void draw_rows(const DrawArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(draw_rows_kernel, args, args.n_draws, stream);
}

void share_rows(const ShareArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(share_rows_kernel, args, args.n_rows, stream);
}

void add_mean_noise(const MeanNoiseArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(mean_noise_kernel, args, args.n_gaussians, stream);
}

}  // namespace b3dgs::cuda
