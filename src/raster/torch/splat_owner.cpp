#include "raster/torch/splat_owner.h"

#include "raster/cpu/passes.h"
#include "raster/torch/tensors.h"

#if B3DGS_TORCH_CUDA
#include "raster/cuda/passes.h"
#include "raster/torch/torch_cuda.h"
#endif

namespace b3dgs {

ViewStatistics SplatOwner::keep(const ViewSplats& splats, const torch::Tensor& splat_grads, std::int64_t n_gaussians,
                                const SplatRecordTensors& out) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<SplatGradSum>("splat_grads", splat_grads, "M");
  check.bind("N", n_gaussians);
  const torch::TensorOptions options = splats.splats.options();
  constexpr std::int64_t kSpare = 4;
  place_tensor(statistics_.means2d_grad, means2d_storage_, {n_gaussians, 2}, options, kSpare);
  place_tensor(statistics_.radii, radii_storage_, {n_gaussians}, options.dtype(torch::kInt32), kSpare);
  const KeepSplatsArgs args{n_gaussians, rows, sums, arrays_of(out, rows.n_splats, check, statistics_.means2d_grad),
                            statistics_.radii.data_ptr<std::int32_t>()};
  if (check.is_cpu()) cpu::keep_splats(args);
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) cuda::keep_splats(args, torch_launch_context());
#endif
  return statistics_;
}

void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<ScoreSums>("scores", scores, "M", torch::kInt32);
  const AddScoresArgs args{rows.splats, rows.n_splats, sums, arrays_of(out, check)};
  if (check.is_cpu()) cpu::add_scores(args);
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) cuda::add_scores(args, /*radii=*/nullptr, torch_launch_context());
#endif
}

torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<SplatGradSum>("splat_grads", splat_grads, "M");
  const torch::TensorOptions options = splats.splats.options();
  const torch::Tensor parts = torch::empty({rows.n_splats, kCameraGradients}, options);
  const GaussianArrays arrays = arrays_of(gaussians, options.device());
  if (check.is_cpu()) {
    cpu::camera_parts({arrays, view, settings.sh_degree, settings.antialiasing}, rows, sums, parts.data_ptr<float>());
  }
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) {
    cuda::ProjectBackwardCudaArgs backward{arrays, view, settings.sh_degree, nullptr, rows.splats, sums};
    backward.antialiasing = settings.antialiasing;
    const torch::Tensor scratch =
        torch::empty({cuda::kCameraGradientParts + 1, kCameraGradients}, options.dtype(torch::kFloat64));
    double* const sum = scratch.data_ptr<double>();  // not used, like the parts of blocks behind it
    cuda::camera_gradient({backward, nullptr, rows.n_splats, sum + kCameraGradients, sum, parts.data_ptr<float>()},
                          torch_launch_context());
  }
#endif
  return parts;
}

torch::Tensor sum_camera_parts(const torch::Tensor& parts) {
  TensorCheck(parts).dims("parts", parts, {"M", kCameraGradients});
  const torch::TensorOptions doubles = parts.options().dtype(torch::kFloat64);
  const torch::Tensor sum = torch::empty({kCameraGradients}, doubles);
  if (parts.is_cpu()) cpu::sum_camera_parts(parts.data_ptr<float>(), parts.size(0), sum.data_ptr<double>());
#if B3DGS_TORCH_CUDA
  if (!parts.is_cpu()) {
    const torch::Tensor scratch = torch::empty({cuda::kCameraGradientParts, kCameraGradients}, doubles);
    cuda::sum_camera_parts(parts.data_ptr<float>(), parts.size(0), scratch.data_ptr<double>(), sum.data_ptr<double>(),
                           torch_launch_context());
  }
#endif
  return sum;
}

}  // namespace b3dgs
