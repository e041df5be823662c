// Compares tensors. A failure reports the index and both values of the worst entry, or of the first that differs.
#pragma once

#include <gtest/gtest.h>
#include <torch/types.h>

#include <string>

namespace b3dgs::test {

/// Returns a flat index as "[row, column, ...]".
inline std::string place_in(const torch::Tensor& tensor, std::int64_t flat) {
  std::string place;
  for (std::int64_t axis = tensor.dim() - 1; axis >= 0; --axis) {
    place = std::to_string(flat % tensor.size(axis)) + (place.empty() ? "" : ", ") + place;
    flat /= tensor.size(axis);
  }
  return "[" + place + "]";
}

/// Returns whether types, shapes and all entries are equal. NaN differs from everything.
inline testing::AssertionResult same(const torch::Tensor& actual, const torch::Tensor& expected) {
  if (!actual.defined() || !expected.defined()) return testing::AssertionFailure() << "an undefined tensor";
  if (actual.scalar_type() != expected.scalar_type() || actual.sizes() != expected.sizes()) {
    return testing::AssertionFailure() << actual.scalar_type() << " " << actual.sizes() << ", expected "
                                       << expected.scalar_type() << " " << expected.sizes();
  }
  if (torch::equal(actual, expected)) return testing::AssertionSuccess();
  const torch::Tensor differing = (actual != expected).flatten().nonzero();
  const std::int64_t first = differing[0].item<std::int64_t>();
  return testing::AssertionFailure() << differing.size(0) << " of " << actual.numel() << " entries differ; first at "
                                     << place_in(expected, first) << ": " << actual.flatten()[first].item<double>()
                                     << ", expected " << expected.flatten()[first].item<double>();
}

/// Returns whether |actual - expected| <= allowed for all entries. `allowed` is broadcast to their shape. NaN fails.
inline testing::AssertionResult within(const torch::Tensor& actual, const torch::Tensor& expected,
                                       const torch::Tensor& allowed) {
  if (!actual.defined() || actual.sizes() != expected.sizes()) {
    return testing::AssertionFailure() << "shape "
                                       << (actual.defined() ? torch::str(actual.sizes()) : std::string("undefined"))
                                       << ", expected " << expected.sizes();
  }
  if (actual.numel() == 0) return testing::AssertionSuccess();
  const torch::Tensor a = actual.detach().to(torch::kFloat64).contiguous();
  const torch::Tensor e = expected.detach().to(torch::kFloat64).contiguous();
  // The tiny constant avoids 0 / 0 if nothing is allowed.
  const torch::Tensor limit = allowed.detach().to(torch::kFloat64).expand_as(e) + 1e-300;
  const torch::Tensor excess = torch::nan_to_num((a - e).abs() / limit, INFINITY, INFINITY);
  const std::int64_t worst = excess.argmax().item<std::int64_t>();
  if (excess.flatten()[worst].item<double>() <= 1.0) return testing::AssertionSuccess();
  return testing::AssertionFailure() << (excess > 1.0).sum().item<std::int64_t>() << " of " << a.numel()
                                     << " entries differ too much; worst at " << place_in(e, worst) << ": "
                                     << a.flatten()[worst].item<double>() << ", expected "
                                     << e.flatten()[worst].item<double>() << " +- "
                                     << limit.flatten()[worst].item<double>();
}

inline testing::AssertionResult within(const torch::Tensor& actual, const torch::Tensor& expected, double allowed) {
  return within(actual, expected, torch::full({}, allowed, torch::kFloat64));
}

}  // namespace b3dgs::test
