// What is learned of the appearance of each photograph (--exposure, --bilateral_grid); part of the training state.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "scene/scene.h"
#include "train/appearance/bilateral_grid.h"
#include "train/appearance/exposure.h"
#include "train/quality/metrics.h"

namespace b3dgs {

/// Undefined tensors: nothing is learned.
struct AppearanceState {
  // By training view; one of the two is defined.
  torch::Tensor exposures;               // [V, 3, 4], transforms: colour' = transform (r, g, b, 1)
  torch::Tensor grids;                   // [V, 8, 16, 16, 12]: bilateral_grid.h
  torch::Tensor m, v;                    // Adam moments, shape of the parameters
  std::int64_t steps = 0;                // of Adam
  std::vector<std::int64_t> last_steps;  // of grids: the step that each view's grid and moments show

  bool is_defined() const { return m.defined(); }
};

/// Calls visit(name, tensor) for each tensor that is defined, in file order.
template <class State, class Visit>
void visit_appearance(State& state, Visit&& visit) {
  if (state.exposures.defined()) visit("exposures", state.exposures);
  if (state.grids.defined()) visit("grids", state.grids);
  if (state.m.defined()) visit("m", state.m);
  if (state.v.defined()) visit("v", state.v);
}

// How a photograph differs from a render of the model because of its camera's settings: exposure, white balance,
// processing. A transform of the render's colours, learned for each training view together with the Gaussians, which
// then need not explain these differences.

/// Transforms renders, and learns how. Reuses its buffers from step to step; asynchronous on a GPU.
class AppearanceModel {
 public:
  virtual ~AppearanceModel() = default;

  /// Whether this model can continue with the state: same kind, same number of views.
  bool fits(const AppearanceState& state) const;

  /// Transforms that change nothing.
  AppearanceState make_state() const;

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

  /// The gradient of the view's transform that step() takes with this place: of the last backward(), unless another one
  /// is copied to it. The same tensor in every step.
  const torch::Tensor& grad() const { return grads_.at(place_); }

  /// One Adam step along the gradient of the last backward() with this place. Allocates nothing. `iteration` counts
  /// from 1.
  virtual void step(std::int32_t view, int iteration, AppearanceState& state) = 0;

 protected:
  /// `transforms`: where the state has them, for each view a tensor of shape `of_view`.
  AppearanceModel(const TrainConfig& config, std::int64_t n_views, torch::Device device,
                  torch::Tensor AppearanceState::*transforms, torch::IntArrayRef of_view);

  const torch::Tensor& photograph() const { return photograph_; }
  const float* transforms_of(const AppearanceState& state, std::int32_t view) const;
  /// Memory for the result of apply().
  float* make_room(const torch::Tensor& rendered);

  const TrainConfig config_;
  const torch::Device device_;
  torch::Tensor corrected_;

 private:
  torch::Tensor AppearanceState::*transforms_;
  const std::int64_t n_views_;
  std::vector<torch::Tensor> grads_;  // by place
  std::size_t place_ = 0;
  torch::Tensor photograph_, corrected_room_;
};

/// The model that the options select; null = none.
std::unique_ptr<AppearanceModel> make_appearance_model(const TrainConfig& config, std::int64_t n_views,
                                                       torch::Device device);

/// An affine transform of the colours of each photograph (--exposure), as in the original 3DGS code: Adam with its own
/// learning rate, which falls log-linearly from config.exposure_lr_init to exposure_lr_final in the last iteration.
class ExposureModel final : public AppearanceModel {
 public:
  ExposureModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) override;
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                torch::Tensor grad) override;
  void step(std::int32_t view, int iteration, AppearanceState& state) override;

 private:
  ExposureArgs args_of(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) const;

  torch::Tensor block_sums_;
  torch::Tensor all_grads_;  // on a CPU: [V, 3, 4], 0 between steps
};

/// A bilateral grid of affine colour transforms for each photograph (--bilateral_grid; bilateral_grid.h). Unlike one
/// transform for the whole image, it can follow vignetting, local tone mapping and glare.
class BilateralGridModel final : public AppearanceModel {
 public:
  BilateralGridModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  void begin_step(std::int32_t view, int iteration, AppearanceState& state) override;
  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) override;
  /// Adds the total variation of the view's grid to the loss.
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                torch::Tensor grad) override;
  void step(std::int32_t view, int iteration, AppearanceState& state) override;

  /// Rises linearly from a hundredth of 0.002 in the first thirtieth of all iterations, and falls
  /// log-linearly to a hundredth at the end; both factors apply throughout.
  double rate(int iteration) const;

 private:
  BilateralGridArgs args_of(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) const;

  torch::Tensor cell_sums_;
  torch::Tensor no_grad_;  // on a CPU: zeros
};

// exposure.json: the colour transforms of a model's training views (--exposure), as the original 3DGS code writes them:
// an object from the name of the view to the rows of its transform [3, 4], colour' = transform (r, g, b, 1). The PLY
// does not include them.

/// By name of the view.
using Exposures = std::map<std::string, ColorTransform>;

/// `exposures` [V, 3, 4] of these views, in their order.
Exposures named_exposures(const torch::Tensor& exposures, const std::vector<View>& views);

/// @throws IoError
void write_exposures(const std::filesystem::path& path, const Exposures& exposures);

/// @throws InputError if the file cannot be read, or is damaged
Exposures read_exposures(const std::filesystem::path& path);

}  // namespace b3dgs
