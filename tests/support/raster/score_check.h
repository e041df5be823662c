// Compares scores and absolute gradients with the dense reference, for any view class with the interface of CpuView
// (cpu_harness.h).
#pragma once

#include "support/approx.h"
#include "support/raster/reference_check.h"

namespace b3dgs::test {

/// Returns sums over the reference's pixels for all N Gaussians, as double.
inline GaussianScores dense_scores(const DenseView& view, const torch::Tensor& error, std::int64_t n) {
  const torch::Tensor nothing = torch::zeros({n}, torch::kFloat64);
  const torch::Tensor largest = view.weights.numel() > 0 ? view.weights.amax(0) : torch::zeros_like(view.rows);
  return {nothing.index_copy(0, view.rows, torch::mv(view.weights.square().t(), error.to(torch::kFloat64).flatten())),
          nothing.index_copy(0, view.rows, largest.to(torch::kFloat64)), torch::Tensor(),
          nothing.index_copy(0, view.rows, view.weights.sum(0))};
}

/// Checks score() of a view with an error that is 0 at pixels near a decision.
template <class FoundView>
void expect_same_scores(FoundView& found, const TestScene& scene, const DenseView& reference) {
  constexpr double kFlip = 0.011;  // largest change of a weight from one decision, see BandLimits
  const std::int64_t n = scene.gaussians.size();
  const torch::Tensor error = uneven_error(scene.view, reference.near_decision);
  const GaussianScores expected = dense_scores(reference, error, n), scores = make_scores(n);
  found.score(error, scores);
  const double flips = kFlip * reference.near_decision.sum().template item<double>();
  // Each weight is rounded, in float and to units of 2^-24.
  const torch::Tensor rounding = 2e-5 * expected.weight_sum + 1e-6;
  EXPECT_TRUE(within(scores.error_sum, expected.error_sum, rounding + 1e-6 * static_cast<double>(error.numel())));
  EXPECT_TRUE(
      within(scores.weight_sum, expected.weight_sum, rounding + 1e-6 * static_cast<double>(error.numel()) + flips));
  EXPECT_TRUE(within(scores.max_weight, expected.max_weight, flips > 0 ? kFlip : 2e-5));
  EXPECT_TRUE(same(scores.n_views, (found.radii() > 0).to(torch::kFloat32)));
}

}  // namespace b3dgs::test
