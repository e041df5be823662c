// Shape checks with named dimensions: the first tensor with a dimension "N" defines it, and later ones must agree.
#pragma once

#include <torch/types.h>

#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"

namespace b3dgs {

class TensorCheck {
 public:
  explicit TensorCheck(torch::Device device) : device_(device) {}

  /// A dimension: a number, or a name for a number.
  struct Dim {
    Dim(int size) : size(size) {}                    // NOLINT(google-explicit-constructor): reads as a list of sizes
    Dim(const char* name) : size(-1), name(name) {}  // NOLINT(google-explicit-constructor)
    std::int64_t size;
    std::string name;
  };

  /// Defines a dimension.
  void bind(const std::string& name, std::int64_t size) { bound_.push_back({name, size, "the caller"}); }

  /// Checks that `tensor` is of type `type` (float or int32), contiguous, on the device, and has these dimensions.
  /// @throws LogicError such as "quats is [99, 4], expected [N, 4]; N is 100 from means"
  void dims(const std::string& what, const torch::Tensor& tensor, std::initializer_list<Dim> wanted,
            torch::ScalarType type = torch::kFloat32) {
    B3DGS_CHECK(tensor.defined(), what, " is undefined");
    bool fits = tensor.dim() == static_cast<std::int64_t>(wanted.size());
    std::string expected, origins;
    std::int64_t axis = 0;
    for (const Dim& dim : wanted) {
      expected += (axis > 0 ? ", " : "") + (dim.name.empty() ? std::to_string(dim.size) : dim.name);
      const std::int64_t found = axis < tensor.dim() ? tensor.size(axis) : -1;
      ++axis;
      if (dim.name.empty()) {
        fits = fits && found == dim.size;
      } else if (const Bound* bound = find(dim.name)) {
        fits = fits && found == bound->size;
        origins += "; " + dim.name + " is " + std::to_string(bound->size) + " from " + bound->from;
      } else {
        bound_.push_back({dim.name, found, what});
      }
    }
    B3DGS_CHECK(fits, what, " is ", tensor.sizes(), ", expected [", expected, "]", origins);
    B3DGS_CHECK(tensor.device() == device_, what, " is on ", tensor.device().str(), ", expected ", device_.str());
    B3DGS_CHECK(tensor.scalar_type() == type, what, " is ", tensor.scalar_type(), ", expected ",
                type == torch::kInt32 ? "int32" : "float");
    B3DGS_CHECK(tensor.is_contiguous(), what, " is not contiguous");
  }

 private:
  struct Bound {
    std::string name;
    std::int64_t size;
    std::string from;
  };
  const Bound* find(const std::string& name) const {
    for (const Bound& bound : bound_) {
      if (bound.name == name) return &bound;
    }
    return nullptr;
  }

  torch::Device device_;
  std::vector<Bound> bound_;
};

}  // namespace b3dgs
