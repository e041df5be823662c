// From checked tensors to the rasterizer's argument structs. @throws LogicError naming a tensor that does not fit
#pragma once

#include "raster/splat_rows.h"
#include "raster/torch/rasterizer.h"
#include "raster/torch/tensor_check.h"

namespace b3dgs {

inline float* data_or_null(const torch::Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<float>() : nullptr;
}

inline GaussianArrays arrays_of(const GaussianTensors& g, torch::Device device) {
  TensorCheck check(device);
  check.dims("means", g.means, {"N", 3});
  check.dims("log_scales", g.log_scales, {"N", 3});
  check.dims("quats", g.quats, {"N", 4});
  check.dims("logit_opacities", g.logit_opacities, {"N"});
  check.dims("sh0", g.sh0, {"N", 1, 3});
  check.dims("shN", g.shN, {"N", "K-1", 3});
  if (g.filters.defined()) check.dims("filters", g.filters, {"N"});
  return {g.means.size(0),           sh_degree_of(g),
          g.means.data_ptr<float>(), g.log_scales.data_ptr<float>(),
          g.quats.data_ptr<float>(), g.logit_opacities.data_ptr<float>(),
          g.sh0.data_ptr<float>(),   g.shN.data_ptr<float>(),
          data_or_null(g.filters)};
}

/// `check` must know "N".
inline ScoreArrays arrays_of(const GaussianScores& scores, TensorCheck& check) {
  check.dims("error_sum", scores.error_sum, {"N"});
  if (scores.weight_sum.defined()) check.dims("weight_sum", scores.weight_sum, {"N"});
  check.dims("max_weight", scores.max_weight, {"N"});
  check.dims("n_views", scores.n_views, {"N"});
  return {scores.error_sum.data_ptr<float>(), data_or_null(scores.weight_sum), scores.max_weight.data_ptr<float>(),
          scores.n_views.data_ptr<float>()};
}

/// A tensor of rows of 32-bit words as an array of structs with 16-byte loads.
template <class Row>
Row* rows_at(const std::string& what, const torch::Tensor& tensor) {
  void* const data = tensor.data_ptr();
  B3DGS_CHECK(reinterpret_cast<std::uintptr_t>(data) % alignof(Row) == 0, what, " is not aligned to ", alignof(Row),
              " bytes");
  return static_cast<Row*>(data);
}

/// Defines "M" of `check`.
inline SplatRows rows_of(const ViewSplats& view, TensorCheck& check) {
  constexpr int kColumns = sizeof(Splat) / sizeof(float);
  check.dims("splats", view.splats, {"M", kColumns});
  check.dims("extents", view.extents, {"M", 2});
  check.dims("radii", view.radii, {"M"}, torch::kInt32);
  return {view.splats.size(0), rows_at<Splat>("splats", view.splats), rows_at<Vec2f>("extents", view.extents),
          view.radii.data_ptr<std::int32_t>()};
}

/// Room for the records of at least `n_splats` splats of N Gaussians; `check` must know "N".
inline SplatRecordArrays arrays_of(const SplatRecordTensors& out, std::int64_t n_splats, TensorCheck& check,
                                   const torch::Tensor& means2d_grad) {
  constexpr int kColumns = sizeof(SplatRecord) / sizeof(float);
  check.dims("records", out.records, {"capacity", kColumns});
  B3DGS_CHECK(out.records.size(0) >= n_splats, "room for ", out.records.size(0), " records of ", n_splats, " splats");
  check.dims("record_of_gaussian", out.record_of_gaussian, {"N"}, torch::kInt32);
  return {rows_at<SplatRecord>("records", out.records), out.record_of_gaussian.data_ptr<std::int32_t>(),
          means2d_grad.data_ptr<float>()};
}

}  // namespace b3dgs
