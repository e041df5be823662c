// The error for a Gaussian that cannot be rendered.
#pragma once

#include <cstdint>
#include <string>

#include "core/check.h"

namespace b3dgs {

/// A Gaussian whose parameters, projection or colour are not finite or beyond the limits in constants.h. Training
/// removes that Gaussian and continues.
class InvalidGaussianError : public NumericError {
 public:
  InvalidGaussianError(std::int64_t row, const std::string& message) : NumericError(message), row_(row) {}

  /// Row of the Gaussian in the parameter arrays.
  std::int64_t row() const { return row_; }

 private:
  std::int64_t row_;
};

}  // namespace b3dgs
