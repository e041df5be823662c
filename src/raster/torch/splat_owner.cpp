#include "raster/torch/splat_owner.h"

#include "raster/cpu/passes.h"
#include "raster/torch/tensor_arrays.h"
#include "raster/torch/tensor_storage.h"

#if B3DGS_TORCH_CUDA
#include "raster/cuda/passes.h"
#include "raster/torch/torch_launch.h"
#endif

namespace b3dgs {

ViewStatistics SplatOwner::keep(const ViewSplats& splats, const torch::Tensor& sums, std::int64_t n_gaussians,
                                bool absolute_gradient, const KeptSplats& out) {
  B3DGS_CHECK(splats.splats.defined(), "splats is undefined");
  const torch::Device device = splats.splats.device();
  TensorCheck check(device);
  const SplatRows rows = rows_of(splats, check);
  constexpr int kWords = sizeof(SplatGradSum) / sizeof(float);
  check.dims("sums", sums, {"M", kWords});
  check.bind("N", n_gaussians);

  const torch::TensorOptions options = splats.splats.options();
  constexpr std::int64_t kSpare = 4;
  place_tensor(statistics_.means2d_grad, means2d_storage_, {n_gaussians, 2}, options, kSpare);
  place_tensor(statistics_.radii, radii_storage_, {n_gaussians}, options.dtype(torch::kInt32), kSpare);
  statistics_.means2d_abs_grad = torch::Tensor();
  if (absolute_gradient) {
    place_tensor(statistics_.means2d_abs_grad, means2d_abs_storage_, {n_gaussians, 2}, options, kSpare);
  }
  const KeepSplatsArgs args{n_gaussians,
                            rows,
                            rows_at<SplatGradSum>("sums", sums),
                            arrays_of(out, rows.n_splats, check, statistics_.means2d_grad),
                            statistics_.radii.data_ptr<std::int32_t>(),
                            data_or_null(statistics_.means2d_abs_grad)};
  if (device.is_cpu()) cpu::keep_splats(args);
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) cuda::keep_splats(args, torch_launch_context());
#endif
  return statistics_;
}

torch::Tensor sum_splat_pairs(const SplatPairs& pairs) {
  B3DGS_CHECK(pairs.sums.defined() && pairs.counts.defined(), "pairs are undefined");
  const torch::Device device = pairs.sums.device();
  constexpr int kWords = sizeof(SplatGradSum) / sizeof(float), kGradWords = sizeof(SplatGrad) / sizeof(float);
  const std::int64_t n_splats = pairs.counts.size(0);
  TensorCheck check(device);
  check.dims("counts", pairs.counts, {"M"}, torch::kInt64);
  check.dims("sums of pairs", pairs.sums, {"pairs", kWords});
  const torch::Tensor offsets = torch::cat({pairs.counts.new_zeros({1}), pairs.counts.cumsum(0)});
  B3DGS_CHECK(offsets[n_splats].item<std::int64_t>() == pairs.sums.size(0), "counts of ", n_splats,
              " splats do not add up to ", pairs.sums.size(0), " pairs");
  const torch::Tensor sums = torch::empty({n_splats, kWords}, pairs.sums.options());
  auto* const out = rows_at<SplatGradSum>("sums", sums);
  const std::int64_t* const slots = offsets.data_ptr<std::int64_t>();
  if (device.is_cpu()) {
    const torch::Tensor grads = pairs.sums.slice(1, 0, kGradWords).contiguous();
    const torch::Tensor absolute = pairs.sums.slice(1, kGradWords).contiguous();
    cpu::sum_splat_grads({n_splats, slots, reinterpret_cast<const SplatGrad*>(grads.data_ptr<float>()),
                          reinterpret_cast<const Vec2f*>(absolute.data_ptr<float>()), out});
  }
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) {
    cuda::sum_splat_grads({n_splats, slots, rows_at<SplatGradSum>("sums of pairs", pairs.sums), out},
                          torch_launch_context());
  }
#endif
  return sums;
}

void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out) {
  B3DGS_CHECK(splats.splats.defined(), "splats is undefined");
  B3DGS_CHECK(out.error_sum.defined(), "error_sum is undefined");
  const torch::Device device = splats.splats.device();
  TensorCheck check(device);
  const SplatRows rows = rows_of(splats, check);
  constexpr int kWords = sizeof(ScoreSums) / sizeof(std::int32_t);
  check.dims("scores", scores, {"M", kWords}, torch::kInt32);
  const AddScoresArgs args{rows.splats, rows.n_splats, nullptr, rows_at<ScoreSums>("scores", scores),
                           arrays_of(out, check)};
  if (device.is_cpu()) cpu::add_scores(args);
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) cuda::add_scores(args, torch_launch_context());
#endif
}

}  // namespace b3dgs
