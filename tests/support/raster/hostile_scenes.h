// Extreme and invalid random scenes with NaN, infinities, and huge and degenerate Gaussians and cameras. A rasterizer
// must either render a finite image with finite gradients or throw a NumericError that names a Gaussian.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <random>
#include <string>

#include "core/check.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {

/// Random numbers that are the same on every machine. The C++ standard fixes engines, but not distributions.
class Dice {
 public:
  explicit Dice(std::uint32_t seed) : engine_(seed) {}
  int below(int n) { return static_cast<int>(engine_() % static_cast<std::uint32_t>(n)); }
  bool one_in(int n) { return below(n) == 0; }
  double uniform(double low, double high) { return low + (high - low) * (engine_() / 4294967296.0); }
  /// Returns a random power of ten with an exponent in the range, of either sign.
  float power_of_ten(double low, double high) {
    const double value = std::pow(10.0, uniform(low, high));
    return static_cast<float>(one_in(2) ? value : -value);
  }

 private:
  std::mt19937 engine_;
};

/// Makes Gaussians in front of the camera, some of them with an extreme or invalid parameter.
inline TestScene hostile_scene(std::uint32_t seed) {
  Dice dice(seed);
  const int n = 1 + dice.below(48), degree_max = dice.below(4);
  TestScene scene;
  scene.sh_degree = dice.below(degree_max + 1);
  scene.view.width = 1 + dice.below(50);
  scene.view.height = 1 + dice.below(40);
  scene.view.fx = static_cast<float>(scene.view.width * (dice.one_in(4) ? std::pow(10.0, dice.uniform(-6, 6)) : 1.0));
  scene.view.fy = dice.one_in(4) ? scene.view.fx * 1000 : scene.view.fx;
  scene.view.cx = dice.one_in(6) ? dice.power_of_ten(0, 6) : 0.5f * static_cast<float>(scene.view.width);
  scene.view.cy = 0.5f * static_cast<float>(scene.view.height);
  scene.view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  scene.view.translation = {0, 0, 0};
  if (dice.one_in(6)) scene.view.translation.z = dice.power_of_ten(0, 12);
  scene.view.center = {0, 0, -scene.view.translation.z};

  GaussianTensors& g = scene.gaussians;
  const std::int64_t rest = (degree_max + 1) * (degree_max + 1) - 1;
  g.means = torch::zeros({n, 3});
  g.log_scales = torch::zeros({n, 3});
  g.quats = torch::zeros({n, 4});
  g.logit_opacities = torch::zeros({n});
  g.sh0 = torch::zeros({n, 1, 3});
  g.shN = torch::zeros({n, rest, 3});
  const auto fill = [&](torch::Tensor& tensor, double low, double high) {
    for (std::int64_t i = 0; i < tensor.numel(); ++i) {
      tensor.data_ptr<float>()[i] = static_cast<float>(dice.uniform(low, high));
    }
  };
  fill(g.means, -1, 1);
  for (int i = 0; i < n; ++i) g.means[i][2] += dice.uniform(0.5, 4) - scene.view.translation.z;
  fill(g.log_scales, -5, 0);
  fill(g.quats, -1, 1);
  fill(g.logit_opacities, -3, 6);
  fill(g.sh0, -1, 2);
  fill(g.shN, -0.5, 0.5);

  const bool may_be_infinite = dice.one_in(3);
  const int how_often = 1 + dice.below(20);
  for (int i = 0; i < n; ++i) {
    if (!dice.one_in(how_often)) continue;
    const std::array<torch::Tensor*, 6> groups = g.all();
    const std::size_t which = static_cast<std::size_t>(dice.below(6));
    torch::Tensor row = (*groups[which])[i].view({-1});
    if (row.numel() == 0) continue;
    const int place = dice.below(static_cast<int>(row.numel()));
    if (may_be_infinite && dice.one_in(4)) {
      const float values[] = {NAN, INFINITY, -INFINITY, std::numeric_limits<float>::max(),
                              std::numeric_limits<float>::denorm_min()};
      row[place] = values[dice.below(5)];
    } else if (groups[which] == &g.log_scales) {
      row[place] = dice.uniform(-120, 60);
    } else if (groups[which] == &g.quats) {
      row *= std::pow(10.0, dice.uniform(-30, 30)) * (dice.one_in(8) ? 0 : 1);
    } else if (groups[which] == &g.means && dice.one_in(2)) {
      row[2] = (dice.one_in(2) ? kNearPlane : 0.0f) - scene.view.translation.z;
    } else {
      row[place] = dice.power_of_ten(0, may_be_infinite ? 38 : 12);
    }
  }
  return scene;
}

/// Returns the number of scenes: 400, or the value of the environment variable B3DGS_HOSTILE_SCENES.
inline std::uint32_t hostile_scene_count() {
  const char* asked = std::getenv("B3DGS_HOSTILE_SCENES");
  return asked != nullptr ? static_cast<std::uint32_t>(std::atoll(asked)) : 400;
}

inline testing::AssertionResult all_finite(const torch::Tensor& tensor, const char* what) {
  if (torch::isfinite(tensor).all().item<bool>()) return testing::AssertionSuccess();
  return testing::AssertionFailure() << what << " is not finite";
}

/// Number of scenes that were rendered, and that ended with an error.
struct HostileOutcome {
  int rendered = 0, refused = 0;
};

/// Renders a scene. View is CpuView or CudaView.
template <class View>
void expect_finite_or_refused(const TestScene& scene, const RenderSettings& settings, HostileOutcome& outcome) {
  try {
    View view(scene, settings);
    EXPECT_TRUE(all_finite(view.color, "colour") && all_finite(view.depth, "depth") && all_finite(view.alpha, "alpha"));
    const DenseGradients gradients = view.backward(uneven_grad(scene.view));
    for (std::size_t i = 0; i < gradients.parameters.all().size(); ++i) {
      EXPECT_TRUE(all_finite(*gradients.parameters.all()[i], GaussianTensors::kNames[i])) << "a gradient";
    }
    EXPECT_TRUE(all_finite(gradients.means2d, "the gradient with respect to the projected centres"));
    const SurfaceView surface = view.geometry(DepthKind::kSurface);
    EXPECT_TRUE(all_finite(surface.depth, "surface") && all_finite(surface.normal, "normal") &&
                all_finite(surface.confidence, "confidence"));
    ++outcome.rendered;
  } catch (const NumericError& error) {
    EXPECT_EQ(std::string(error.what()).rfind("Gaussian ", 0), 0u) << error.what();
    ++outcome.refused;
  }
}

/// Returns settings for a scene. Culling changes with the seed.
inline RenderSettings hostile_settings(const TestScene& scene, std::uint32_t seed) {
  RenderSettings settings = settings_of(scene);
  settings.culling = seed % 2 == 0 ? Culling::kEllipse : Culling::kSquare;
  return settings;
}

}  // namespace b3dgs::test
