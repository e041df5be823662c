// How a photograph differs from a render of the model because of its camera's settings: exposure, white balance,
// processing. A transform of the render's colours, learned for each training view together with the Gaussians, which
// then need not explain these differences.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "train/appearance/appearance_state.h"

namespace b3dgs {

/// Transforms renders, and learns how. Reuses its buffers from step to step; asynchronous on a GPU.
class AppearanceModel {
 public:
  virtual ~AppearanceModel() = default;

  /// Whether this model can continue with the state: same kind, same number of views.
  virtual bool fits(const AppearanceState& state) const = 0;

  /// Transforms that change nothing.
  virtual AppearanceState make_state() const = 0;

  /// Which view of its step the next backward() and step() are for, from 0 to --batch - 1: gradients of several views
  /// are kept until the steps are taken.
  void set_place(int place) { place_ = static_cast<std::size_t>(place); }

  /// The photograph [H, W, 3] uint8 that the next apply() and backward() are compared with; undefined: none. Where it
  /// is clipped, a brighter render is no error.
  void set_photograph(const torch::Tensor& photograph) { photograph_ = photograph; }

  /// Before the step of `iteration` (counted from 1) reads the view's transform: applies what was deferred. May be
  /// repeated if a step fails.
  virtual void begin_step(std::int32_t /*view*/, int /*iteration*/, AppearanceState& /*state*/) {}

  /// `rendered` [H, W, 3] as photograph `view` shows it, valid until the next call.
  virtual torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) = 0;

  /// Turns `grad` [H, W, 3], dL/d(result of apply()), into dL/d(rendered), in place, and keeps the gradient of the
  /// transform for step(). Arguments as in apply().
  virtual void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                        torch::Tensor grad) = 0;

  /// The gradient of the transform that step() takes with this place: of the last backward(), unless another one is
  /// copied to it. The same tensor in every step.
  virtual torch::Tensor grad() const = 0;

  /// One Adam step along the gradient of the last backward() with this place. Allocates nothing. `iteration` counts
  /// from 1.
  virtual void step(std::int32_t view, int iteration, AppearanceState& state) = 0;

 protected:
  std::size_t place() const { return place_; }
  const torch::Tensor& photograph() const { return photograph_; }

 private:
  std::size_t place_ = 0;
  torch::Tensor photograph_;
};

/// The model that the options select; null = none.
std::unique_ptr<AppearanceModel> make_appearance_model(const TrainConfig& config, std::int64_t n_views,
                                                       torch::Device device);

}  // namespace b3dgs
