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
  B3DGS_CHECK(splats.splats.defined(), "splats is undefined");
  const torch::Device device = splats.splats.device();
  TensorCheck check(device);
  const SplatRows rows = rows_of(splats, check);
  constexpr int kColumns = sizeof(SplatGradSum) / sizeof(float);
  check.dims("splat_grads", splat_grads, {"M", kColumns});
  check.bind("N", n_gaussians);

  const torch::TensorOptions options = splats.splats.options();
  constexpr std::int64_t kSpare = 4;
  place_tensor(statistics_.means2d_grad, means2d_storage_, {n_gaussians, 2}, options, kSpare);
  place_tensor(statistics_.radii, radii_storage_, {n_gaussians}, options.dtype(torch::kInt32), kSpare);
  const KeepSplatsArgs args{n_gaussians, rows, rows_at<SplatGradSum>("splat_grads", splat_grads),
                            arrays_of(out, rows.n_splats, check, statistics_.means2d_grad),
                            statistics_.radii.data_ptr<std::int32_t>()};
  if (device.is_cpu()) cpu::keep_splats(args);
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) cuda::keep_splats(args, torch_launch_context());
#endif
  return statistics_;
}

void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out) {
  B3DGS_CHECK(splats.splats.defined(), "splats is undefined");
  B3DGS_CHECK(out.error_sum.defined(), "error_sum is undefined");
  const torch::Device device = splats.splats.device();
  TensorCheck check(device);
  const SplatRows rows = rows_of(splats, check);
  constexpr int kColumns = sizeof(ScoreSums) / sizeof(std::int32_t);
  check.dims("scores", scores, {"M", kColumns}, torch::kInt32);
  const AddScoresArgs args{rows.splats, rows.n_splats, nullptr, rows_at<ScoreSums>("scores", scores),
                           arrays_of(out, check)};
  if (device.is_cpu()) cpu::add_scores(args);
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) cuda::add_scores(args, /*radii=*/nullptr, torch_launch_context());
#endif
}

torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings) {
  B3DGS_CHECK(splats.splats.defined(), "splats is undefined");
  const torch::Device device = splats.splats.device();
  TensorCheck check(device);
  const SplatRows rows = rows_of(splats, check);
  constexpr int kColumns = sizeof(SplatGradSum) / sizeof(float);
  check.dims("splat_grads", splat_grads, {"M", kColumns});
  const torch::TensorOptions options = splats.splats.options();
  const torch::Tensor parts = torch::empty({rows.n_splats, kCameraGradients}, options);
  const CameraPartsArgs args{{arrays_of(gaussians, device), view, settings.sh_degree, settings.antialiasing},
                             rows.n_splats,
                             rows.splats,
                             rows_at<SplatGradSum>("splat_grads", splat_grads),
                             parts.data_ptr<float>()};
  if (device.is_cpu()) cpu::camera_parts(args);
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) {
    cuda::ProjectBackwardCudaArgs backward;
    backward.gaussians = args.of.gaussians;
    backward.view = view;
    backward.sh_degree = settings.sh_degree;
    backward.splats = args.splats;
    backward.splat_grads = args.splat_grads;
    backward.antialiasing = settings.antialiasing;
    const torch::Tensor scratch =
        torch::empty({cuda::kCameraGradientParts + 1, kCameraGradients}, options.dtype(torch::kFloat64));
    double* const sum = scratch.data_ptr<double>();  // not used, like the parts of blocks behind it
    cuda::camera_gradient({backward, nullptr, args.n_splats, sum + kCameraGradients, sum, args.out},
                          torch_launch_context());
  }
#endif
  return parts;
}

torch::Tensor sum_camera_parts(const torch::Tensor& parts) {
  B3DGS_CHECK(parts.defined(), "parts is undefined");
  TensorCheck(parts.device()).dims("parts", parts, {"M", kCameraGradients});
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
