// A background that is learned with the scene (--background learned, sky), on tensors.
#pragma once

#include <torch/types.h>

#include <cstdint>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// The parameters and their Adam moments. All undefined: there is no learned background.
struct BackgroundState {
  torch::Tensor coefficients;  // [K, 3] as in background_args.h, K = 1 or 25
  torch::Tensor m, v;          // first and second moments, [K, 3]
  std::int64_t steps = 0;      // taken so far

  bool is_defined() const { return coefficients.defined(); }
};

/// Grey in all directions. `degree` is learned_background_degree(): with -1, nothing is defined.
BackgroundState make_background(int degree, torch::Device device);

/// Adds the background to rendered.color, in place; the view must have been rendered on black. Does nothing if
/// `coefficients` is undefined. Asynchronous on a GPU.
void add_background(const torch::Tensor& coefficients, const PinholeView& view, const RenderedView& rendered);

/// Gradients of a training step. Reuses its memory from view to view.
class BackgroundGradient {
 public:
  /// From the gradient with respect to the colours that add_background() left, [H, W, 3], computes that with respect to
  /// the coefficients, and returns that with respect to the render's alpha [H, W], valid until the next call.
  torch::Tensor compute(const BackgroundState& background, const PinholeView& view, const RenderedView& rendered,
                        const torch::Tensor& grad_color);

  /// [K, 3] of the last compute().
  const torch::Tensor& coefficients() const { return grad_; }

  /// An Adam step along the last gradients. Does not allocate, so that it cannot fail after the step of the Gaussians.
  void step(double rate, BackgroundState& background) const;

  /// For a step along several views: adds the coefficients() of each, in their order, to a sum, which `is_first`
  /// begins.
  void add_to_sum(const torch::Tensor& coefficients, bool is_first);
  /// step() along the mean of n gradients, with sqrt(n) times `rate` and the moments' decays by adam_rule().
  void step_along_mean(double rate, int n_views, BackgroundState& background);

 private:
  torch::Tensor alpha_, alpha_room_, parts_, parts_room_, grad_, sum_;
};

}  // namespace b3dgs
