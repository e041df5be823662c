// Shape checks with named dimensions: the first tensor with a dimension "N" defines it, and later ones must agree.
#pragma once

#include <torch/types.h>

#include <initializer_list>
#include <map>
#include <string>
#include <vector>

#include "core/check.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// Number of 32-bit words of a struct, which is the number of columns of a tensor of such structs.
template <class Row>
inline constexpr int kWords = sizeof(Row) / 4;

template <class Row>
Row* rows_at(const torch::Tensor& tensor) {
  return static_cast<Row*>(tensor.data_ptr());
}

class TensorCheck {
 public:
  explicit TensorCheck(torch::Device device) : device_(device) {}
  /// Checks tensors on the device of `like`, if it is defined.
  explicit TensorCheck(const torch::Tensor& like) : device_(like.defined() ? like.device() : torch::kCPU) {}
  bool is_cpu() const { return device_.is_cpu(); }

  /// A dimension: a number, or a name for a number.
  struct Dim {
    Dim(int size) : size(size) {}          // NOLINT(google-explicit-constructor): reads as a list of sizes
    Dim(const char* name) : name(name) {}  // NOLINT(google-explicit-constructor)
    std::int64_t size = -1;
    const char* name = nullptr;
  };

  /// Defines a dimension.
  void bind(const std::string& name, std::int64_t size) { sizes_[name] = size; }

  /// Checks that `tensor` has this type and these dimensions, is contiguous and is on the device.
  /// @throws LogicError such as "quats is [99, 4], expected [100, 4]", where -1 means any number
  void dims(const std::string& what, const torch::Tensor& tensor, std::initializer_list<Dim> wanted,
            torch::ScalarType type = torch::kFloat32) {
    B3DGS_CHECK(tensor.defined(), what, " is undefined");
    std::vector<std::int64_t> expected;
    for (const Dim& dim : wanted) {
      const auto axis = static_cast<std::int64_t>(expected.size());
      const std::int64_t found = axis < tensor.dim() ? tensor.size(axis) : -1;
      expected.push_back(dim.name == nullptr ? dim.size : sizes_.try_emplace(dim.name, found).first->second);
    }
    B3DGS_CHECK(tensor.sizes() == expected, what, " is ", tensor.sizes(), ", expected ", torch::IntArrayRef(expected));
    B3DGS_CHECK(tensor.device() == device_, what, " is on ", tensor.device(), ", expected ", device_);
    B3DGS_CHECK(tensor.scalar_type() == type, what, " is ", tensor.scalar_type(), ", expected ", type);
    B3DGS_CHECK(tensor.is_contiguous(), what, " is not contiguous");
  }

  /// Checks that `tensor` has rows of this struct, and that they are aligned.
  template <class Row>
  Row* rows(const std::string& what, const torch::Tensor& tensor, const char* count,
            torch::ScalarType type = torch::kFloat32) {
    dims(what, tensor, {count, kWords<Row>}, type);
    B3DGS_CHECK(reinterpret_cast<std::uintptr_t>(tensor.data_ptr()) % alignof(Row) == 0, what, " is not aligned to ",
                alignof(Row), " bytes");
    return rows_at<Row>(tensor);
  }

 private:
  torch::Device device_;
  std::map<std::string, std::int64_t> sizes_;  // of named dimensions
};

// Converts checked tensors to the rasterizer's argument structs. @throws LogicError naming a tensor that does not fit

template <class Value = float>
Value* data_or_null(const torch::Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<Value>() : nullptr;
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

/// Gives `grads` the shapes of `gaussians`, with undefined contents. Replaces tensors that do not have them.
inline GaussianGradArrays make_gradients(const GaussianTensors& gaussians, GaussianTensors& grads,
                                         float* means2d = nullptr) {
  for (std::size_t i = 0; i < grads.all().size(); ++i) {
    const torch::Tensor& parameter = *gaussians.all()[i];
    torch::Tensor& grad = *grads.all()[i];
    const bool fits = grad.defined() && grad.sizes() == parameter.sizes() && grad.is_contiguous() &&
                      grad.dtype() == parameter.dtype() && grad.device() == parameter.device();
    if (!fits) grad = torch::empty_like(parameter);
  }
  return {grads.means.data_ptr<float>(),
          grads.log_scales.data_ptr<float>(),
          grads.quats.data_ptr<float>(),
          grads.logit_opacities.data_ptr<float>(),
          grads.sh0.data_ptr<float>(),
          grads.shN.data_ptr<float>(),
          means2d};
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

/// Defines "M" of `check`.
inline SplatRows rows_of(const ViewSplats& view, TensorCheck& check) {
  const Splat* const splats = check.rows<Splat>("splats", view.splats, "M");
  const Vec2f* const extents = check.rows<Vec2f>("extents", view.extents, "M");
  check.dims("radii", view.radii, {"M"}, torch::kInt32);
  return {view.splats.size(0), splats, extents, view.radii.data_ptr<std::int32_t>()};
}

/// Returns arrays for the records of at least `n_splats` splats of N Gaussians. `check` must know "N".
inline SplatRecordArrays arrays_of(const SplatRecordTensors& out, std::int64_t n_splats, TensorCheck& check,
                                   const torch::Tensor& means2d_grad) {
  auto* const records = check.rows<SplatRecord>("records", out.records, "capacity");
  B3DGS_CHECK(out.records.size(0) >= n_splats, "room for ", out.records.size(0), " records of ", n_splats, " splats");
  check.dims("record_of_gaussian", out.record_of_gaussian, {"N"}, torch::kInt32);
  return {records, out.record_of_gaussian.data_ptr<std::int32_t>(), means2d_grad.data_ptr<float>()};
}

// Tensors whose size changes from view to view (photographs of different sizes, a growing model), in memory that only
// grows, so that steps do not allocate.

/// Makes `tensor` a view of the beginning of `storage`, with these sizes and undefined contents, unless it already has
/// them. `storage` is a flat tensor. If it is too small, it is replaced by one with 1/spare_part more elements than
/// needed (0: exactly as many).
inline void place_tensor(torch::Tensor& tensor, torch::Tensor& storage, torch::IntArrayRef sizes,
                         const torch::TensorOptions& options, std::int64_t spare_part = 0) {
  if (tensor.defined() && tensor.sizes() == sizes && tensor.dtype() == options.dtype() &&
      tensor.device() == options.device()) {
    return;
  }
  std::int64_t n = 1;
  for (const std::int64_t size : sizes) n *= size;
  if (!storage.defined() || storage.numel() < n || storage.dtype() != options.dtype() ||
      storage.device() != options.device()) {
    tensor = storage = torch::Tensor();  // free it before allocating more
    storage = torch::empty({n + (spare_part > 0 ? n / spare_part : 0)}, options);
  }
  tensor = storage.slice(0, 0, n).view(sizes);
}

}  // namespace b3dgs
