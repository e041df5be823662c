// What is learned of the appearance of each photograph (--exposure, --bilateral_grid); part of the training state.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "scene/scene.h"
#include "train/appearance/appearance_kernels.h"
#include "train/quality/metrics.h"

namespace b3dgs {

/// Undefined tensors: nothing is learned.
struct AppearanceState {
  // By training view; one of the two is defined.
  torch::Tensor exposures;               // [V, 3, 4], transforms: colour' = transform (r, g, b, 1)
  torch::Tensor grids;                   // [V, 8, 16, 16, 12]: appearance_kernels.h
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

/// How each photograph's colours differ from those of a render because of its camera's settings (exposure, white
/// balance, processing), which the Gaussians then need not explain. With --exposure an affine transform, as in the
/// original 3DGS code; with --bilateral_grid a grid of them, which can also follow vignetting, local tone mapping and
/// glare. Transforms renders, and learns how together with the Gaussians. Reuses its buffers from step to step;
/// asynchronous on a GPU.
class AppearanceModel {
 public:
  AppearanceModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  /// Whether this model can continue with the state: same kind, same number of views.
  bool fits(const AppearanceState& state) const;

  /// Transforms that change nothing.
  AppearanceState make_state() const;

  /// Which view of its step the next backward() and step() are for, from 0 to --batch - 1: gradients of several views
  /// are kept until the steps are taken.
  void set_place(int place) { place_ = static_cast<std::size_t>(place); }

  /// The photograph [H, W, 3] uint8 that the next apply() and backward() are compared with; undefined: none. Where it
  /// is clipped, a brighter render is no error (with --exposure).
  void set_photograph(const torch::Tensor& photograph) { photograph_ = photograph; }

  /// Before the step of `iteration` (counted from 1) reads the view's transform: applies what was deferred. May be
  /// repeated if a step fails.
  void begin_step(std::int32_t view, int iteration, AppearanceState& state);

  /// `rendered` [H, W, 3] as photograph `view` shows it, valid until the next call.
  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered);

  /// Turns `grad` [H, W, 3], dL/d(result of apply()), into dL/d(rendered), in place, and keeps the gradient of the
  /// transform for step(), with that of a grid's total variation. Arguments as in apply().
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered, torch::Tensor grad);

  /// The gradient of the view's transform that step() takes with this place: of the last backward(), unless another one
  /// is copied to it. The same tensor in every step.
  const torch::Tensor& grad() const { return grads_.at(place_); }

  /// One Adam step along the gradient of the last backward() with this place. Exposures of other views move by their
  /// moments, and then all are shifted so that their mean is the identity. Allocates nothing.
  void step(std::int32_t view, int iteration, AppearanceState& state);

  /// Learning rate. That of exposures falls log-linearly from exposure_lr_init to exposure_lr_final; that of grids
  /// rises linearly from a hundredth of 0.002 in the first thirtieth of all iterations, and falls log-linearly to a
  /// hundredth at the end, where both factors apply throughout.
  double rate(int iteration) const;

 private:
  bool has_grids() const { return config_.bilateral_grid; }
  AppearanceArgs args_of(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) const;
  /// The grid of the view, or all exposures.
  AdamArgs adam_args(std::int32_t view, AppearanceState& state) const;

  const TrainConfig config_;
  const torch::Device device_;
  const std::int64_t n_views_;
  std::vector<torch::Tensor> grads_;  // by place
  std::size_t place_ = 0;
  torch::Tensor photograph_, corrected_, corrected_room_, sums_;
  torch::Tensor step_grads_;  // on a CPU, like AdamArgs::param: 0 between steps
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
