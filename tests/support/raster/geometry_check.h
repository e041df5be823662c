// Compares geometry with the dense reference, for any view class with the interface of CpuView (cpu_harness.h).
#pragma once

#include "support/approx.h"
#include "support/raster/dense_geometry.h"
#include "support/raster/reference_check.h"

namespace b3dgs::test {

inline constexpr DepthKind kDepthKinds[] = {DepthKind::kSurface, DepthKind::kMedian, DepthKind::kMean};

inline bool is_same_surface(const SurfaceView& a, const SurfaceView& b) {
  return torch::equal(a.depth, b.depth) && torch::equal(a.normal, b.normal) && torch::equal(a.confidence, b.confidence);
}

/// Compares pixels that are not near a decision. Almost none may be.
template <class FoundView>
void expect_same_surface(const TestScene& scene, const RenderSettings& settings) {
  constexpr double kDepthError = 2e-5;  // relative, of a float
  const torch::NoGradGuard no_grad;
  const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
  const DenseView reference = dense_render(leaves, scene.view, settings);
  FoundView view(scene, settings);
  for (const DepthKind kind : kDepthKinds) {
    SCOPED_TRACE(names_of(kind)[static_cast<std::size_t>(kind)]);
    const DenseSurface expected = dense_surface(leaves, scene.view, settings, reference, kind);
    const SurfaceView found = view.geometry(kind);
    const std::int64_t n_doubtful = expected.near_decision.sum().item<std::int64_t>();
    EXPECT_LE(n_doubtful, 2 + expected.near_decision.numel() / 50);
    const torch::Tensor certain = torch::logical_not(expected.near_decision).to(torch::kFloat64);
    const torch::Tensor in_doubt = expected.near_decision.to(torch::kFloat64) * 1e9;
    EXPECT_TRUE(within(found.depth, expected.depth, kDepthError * expected.depth + in_doubt)) << "depth";
    EXPECT_TRUE(within(found.normal, expected.normal, in_doubt.unsqueeze(2) + 1e-4)) << "normal";
    // The errors of a value and of the mean move the standard deviation s by twice as much, and the confidence c by
    // 2 c (1 - c) / s times that.
    const torch::Tensor c = expected.confidence;
    const torch::Tensor moved = 4 * kDepthError / double{kConfidentSpread} * c * (c * (1 - c)).sqrt();
    EXPECT_TRUE(within(found.confidence, c, moved + in_doubt + 1e-4)) << "confidence";
    EXPECT_TRUE(torch::isfinite(found.depth).all().item<bool>());
    EXPECT_TRUE(within(found.depth.sign() * certain, expected.depth.sign() * certain, 0)) << "where there is a surface";
  }
}

}  // namespace b3dgs::test
