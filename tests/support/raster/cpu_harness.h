// Test support: the CPU rasterizer on tensors, and a choice of SIMD target and number of threads.
#pragma once

#include <hwy/targets.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/torch/tensors.h"
#include "support/raster/dense_reference.h"
#include "support/raster/test_scenes.h"

namespace b3dgs::test {

/// Limits Highway to one instruction set during its lifetime.
class ScopedSimdTarget {
 public:
  explicit ScopedSimdTarget(std::int64_t target) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  }
  ~ScopedSimdTarget() {
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().DeInit();  // the next call detects the machine again
  }
  ScopedSimdTarget(const ScopedSimdTarget&) = delete;
  ScopedSimdTarget& operator=(const ScopedSimdTarget&) = delete;
};

/// Sets the number of threads during its lifetime.
class ScopedThreadCount {
 public:
  explicit ScopedThreadCount(int n) : before_(thread_count()) { set_thread_count(n); }
  ~ScopedThreadCount() { set_thread_count(before_); }
  ScopedThreadCount(const ScopedThreadCount&) = delete;
  ScopedThreadCount& operator=(const ScopedThreadCount&) = delete;

 private:
  int before_;
};

inline RenderSettings settings_of(const TestScene& scene) {
  RenderSettings settings;
  settings.background = scene.background;
  settings.sh_degree = scene.sh_degree;
  return settings;
}

inline GaussianArrays arrays_of(const TestScene& scene) {
  return b3dgs::arrays_of(scene.gaussians, torch::kCPU);
}

/// Gives each Gaussian a 3D smoothing filter of 0, 0.2, 1 or 3 times its scale.
inline void add_filters(TestScene& scene) {
  const torch::Tensor steps = torch::tensor({0.0f, 0.2f, 1.0f, 3.0f});
  const torch::Tensor rows = torch::arange(scene.gaussians.size(), torch::kInt64) % 4;
  scene.gaussians.filters = (steps.index_select(0, rows) * scene.gaussians.log_scales.mean(1).exp()).contiguous();
}

/// One view of a scene, rendered by the CPU rasterizer. Outputs are NaN before, so that a missing write is noticed.
class CpuView {
 public:
  CpuView(const TestScene& scene, const RenderSettings& settings) : scene_(scene) {
    const std::int64_t h = scene.view.height, w = scene.view.width;
    color = torch::full({h, w, 3}, NAN, torch::kFloat32);
    depth = torch::full({h, w}, NAN, torch::kFloat32);
    alpha = torch::full({h, w}, NAN, torch::kFloat32);
    rasterizer_->forward(arrays_of(scene_), scene_.view, settings,
                         {color.data_ptr<float>(), depth.data_ptr<float>(), alpha.data_ptr<float>()});
  }

  /// Returns gradients in the structure of the dense reference, in float.
  DenseGradients backward(const RenderedViewGrad& grad) {
    DenseGradients out;
    out.parameters = scene_.gaussians;
    for (torch::Tensor* group : out.parameters.all()) *group = torch::full_like(*group, NAN);
    out.means2d = torch::full({scene_.gaussians.size(), 2}, NAN, torch::kFloat32);
    rasterizer_->backward(arrays_of(scene_),
                          {data_or_null(grad.color), data_or_null(grad.depth), data_or_null(grad.alpha)},
                          make_gradients(scene_.gaussians, out.parameters, out.means2d.data_ptr<float>()));
    return out;
  }

  /// Returns the camera gradient of the last backward(), [6] double.
  torch::Tensor camera_gradient() const {
    return torch::from_blob(const_cast<double*>(rasterizer_->camera_gradient()), {kCameraGradients}, torch::kFloat64)
        .clone();
  }

  /// Adds to `scores`, four tensors [N].
  void score(const torch::Tensor& error, const GaussianScores& scores) {
    rasterizer_->score(error.data_ptr<float>(),
                       {scores.error_sum.data_ptr<float>(), scores.weight_sum.data_ptr<float>(),
                        scores.max_weight.data_ptr<float>(), scores.n_views.data_ptr<float>()});
  }

  SurfaceView geometry(DepthKind kind) {
    const std::int64_t h = scene_.view.height, w = scene_.view.width;
    SurfaceView out{torch::full({h, w}, NAN), torch::full({h, w, 3}, NAN), torch::full({h, w}, NAN)};
    rasterizer_->geometry(
        arrays_of(scene_), kind,
        {out.depth.data_ptr<float>(), out.normal.data_ptr<float>(), out.confidence.data_ptr<float>()});
    return out;
  }

  /// [N] int64
  torch::Tensor radii() const {
    torch::Tensor copy = torch::zeros({scene_.gaussians.size()}, torch::kInt64);
    for (std::int64_t i = 0; i < copy.numel(); ++i) copy[i] = std::int64_t{rasterizer_->radii()[i]};
    return copy;
  }

  /// [H, W] int64, index of the last Gaussian blended, -1 if none. Computed from last_ids and the tiles' lists.
  torch::Tensor last_gaussians() const {
    const TileGrid grid = rasterizer_->grid();
    const BinnedSplats bins = rasterizer_->bins();
    torch::Tensor last = torch::full({grid.image_height, grid.image_width}, -1, torch::kInt64);
    auto places = last.accessor<std::int64_t, 2>();
    for (std::int32_t y = 0; y < grid.image_height; ++y) {
      for (std::int32_t x = 0; x < grid.image_width; ++x) {
        const std::int32_t id = rasterizer_->last_ids()[y * grid.image_width + x];
        if (id < 0) continue;
        const std::int32_t tile = y / grid.tile.height * grid.columns + x / grid.tile.width;
        places[y][x] = std::int64_t{rasterizer_->splats()[bins.splat_ids[bins.tile_offsets[tile] + id]].gaussian};
      }
    }
    return last;
  }

  const RasterizerBackend& rasterizer() const { return *rasterizer_; }

  torch::Tensor color, depth, alpha;  // float

 private:
  const TestScene& scene_;
  std::unique_ptr<RasterizerBackend> rasterizer_ = cpu::make_rasterizer();
};

/// Returns gradients of a view with size about 1 that differ between pixels and channels. 0 where `off` is true.
inline RenderedViewGrad uneven_grad(const PinholeView& view, const torch::Tensor& off = {}) {
  const std::int64_t h = view.height, w = view.width;
  const torch::Tensor on = off.defined() ? torch::logical_not(off).to(torch::kFloat32) : torch::ones({h, w});
  const auto wave = [&](std::int64_t n, double frequency) {
    return torch::cos(torch::arange(n, torch::kFloat64) * frequency + 0.3).to(torch::kFloat32);
  };
  return {(wave(h * w * 3, 1.7).view({h, w, 3}) * on.unsqueeze(2)).contiguous(),
          (wave(h * w, 0.9).view({h, w}) * on).contiguous(), (wave(h * w, 2.3).view({h, w}) * on).contiguous()};
}

/// Returns zero scores of N Gaussians.
inline GaussianScores make_scores(std::int64_t n) {
  return {torch::zeros({n}), torch::zeros({n}), torch::zeros({n}), torch::zeros({n})};
}

/// Returns an error [H, W] within [0, 1] that differs between pixels. 0 where `off`, if given, is true.
inline torch::Tensor uneven_error(const PinholeView& view, const torch::Tensor& off = {}) {
  const std::int64_t h = view.height, w = view.width;
  const torch::Tensor wave = torch::sin(torch::arange(h * w, torch::kFloat64) * 0.7).square().view({h, w});
  return (off.defined() ? wave * torch::logical_not(off) : wave).to(torch::kFloat32).contiguous();
}

}  // namespace b3dgs::test
