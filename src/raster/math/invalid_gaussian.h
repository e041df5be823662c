// A Gaussian that cannot be rendered.
#pragma once

#include <cstdint>
#include <string>

#include "core/check.h"

namespace b3dgs {

/// What a Gaussian needs for a view is not finite, or it is wider than any image: without it, the others can go on.
class InvalidGaussianError : public NumericError {
 public:
  InvalidGaussianError(std::int64_t row, const std::string& message) : NumericError(message), row_(row) {}

  /// Of the model's tensors.
  std::int64_t row() const { return row_; }

 private:
  std::int64_t row_;
};

}  // namespace b3dgs
