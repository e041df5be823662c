// Colour differences between photographs that are learned during training (--exposure, --bilateral_grid). They are part
// of the training state.
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

/// State of the appearance model for V training views. Tensors are undefined if nothing is learned.
struct AppearanceState {
  // One of the two is defined.
  torch::Tensor exposures;               // [V, 3, 4] transforms: colour' = transform (r, g, b, 1)
  torch::Tensor grids;                   // [V, 8, 16, 16, 12], see appearance_kernels.h
  torch::Tensor m, v;                    // Adam moments, in the shape of the parameters
  std::int64_t steps = 0;                // number of Adam steps
  std::vector<std::int64_t> last_steps;  // [V] for grids: the last step applied to each view's grid and moments

  bool is_defined() const { return m.defined(); }
};

/// Calls visit(name, tensor) for each defined tensor, in the order of a checkpoint.
template <class State, class Visit>
void visit_appearance(State& state, Visit&& visit) {
  if (state.exposures.defined()) visit("exposures", state.exposures);
  if (state.grids.defined()) visit("grids", state.grids);
  if (state.m.defined()) visit("m", state.m);
  if (state.v.defined()) visit("v", state.v);
}

/// Models how each photograph's colours differ from those of a render because of its camera's settings (exposure, white
/// balance, processing), so that the Gaussians need not explain these differences. With --exposure this is an affine
/// transform, as in the original 3DGS code. With --bilateral_grid it is a grid of them, which can also represent
/// vignetting, local tone mapping and glare. The model transforms renders, and learns its transforms together with the
/// Gaussians. Buffers are reused from step to step. Asynchronous on a GPU.
class AppearanceModel {
 public:
  AppearanceModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  /// Returns whether this model can continue with the state, which must be of the same kind and number of views.
  bool fits(const AppearanceState& state) const;

  /// Returns the initial state, whose transforms are the identity.
  AppearanceState make_state() const;

  /// Sets the index within the step, from 0 to --batch - 1, of the view that the next backward() and step() are for.
  /// The gradients of several views are kept until the steps are taken.
  void set_place(int place) { place_ = static_cast<std::size_t>(place); }

  /// Sets the photograph [H, W, 3] uint8 that the next apply() and backward() compare with, or none if undefined. With
  /// --exposure, a render that is brighter than a clipped pixel of the photograph is not an error.
  void set_photograph(const torch::Tensor& photograph) { photograph_ = photograph; }

  /// Applies the deferred steps of the view's transform. Call this before the step of `iteration` (counted from 1)
  /// reads the transform. Can be repeated if a step fails.
  void begin_step(std::int32_t view, int iteration, AppearanceState& state);

  /// Returns `rendered` [H, W, 3] in the colours of photograph `view`, valid until the next call.
  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered);

  /// Converts `grad` [H, W, 3] from dL/d(result of apply()) to dL/d(rendered), in place. Keeps the gradient of the
  /// transform for step(), including that of a grid's total variation. Other arguments as in apply().
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered, torch::Tensor grad);

  /// Returns the gradient that step() uses for the current index within the step. backward() writes it, unless another
  /// gradient is copied to it. It is the same tensor in every step.
  const torch::Tensor& grad() const { return grads_.at(place_); }

  /// Takes one Adam step along the gradient of the last backward() with the same index within the step. Exposures of
  /// other views move by their moments, and then all are shifted so that their mean is the identity. Allocates nothing.
  void step(std::int32_t view, int iteration, AppearanceState& state);

  /// Returns the learning rate. For exposures, it falls log-linearly from exposure_lr_init to exposure_lr_final. For
  /// grids, it is 0.002 times two factors. One rises linearly from 0.01 to 1 in the first thirtieth of all iterations,
  /// and the other falls log-linearly from 1 to 0.01 over all iterations.
  double rate(int iteration) const;

 private:
  bool has_grids() const { return config_.bilateral_grid; }
  AppearanceArgs args_of(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) const;
  /// Returns the arguments for the grid of the view, or for all exposures.
  AdamArgs adam_args(std::int32_t view, AppearanceState& state) const;

  const TrainConfig config_;
  const torch::Device device_;
  const std::int64_t n_views_;
  std::vector<torch::Tensor> grads_;  // by index within the step
  std::size_t place_ = 0;
  torch::Tensor photograph_, corrected_, corrected_room_, sums_;
  torch::Tensor step_grads_;  // on a CPU, in the shape of AdamArgs::param; 0 between steps
};

// exposure.json contains the colour transforms of a model's training views (--exposure), in the format of the original
// 3DGS code: an object from the name of the view to the rows of its transform [3, 4], colour' = transform (r, g, b, 1).
// The PLY does not include them.

/// Colour transforms by name of the view.
using Exposures = std::map<std::string, ColorTransform>;

/// Returns `exposures` [V, 3, 4] of these views, given in their order.
Exposures named_exposures(const torch::Tensor& exposures, const std::vector<View>& views);

/// Writes the file. @throws IoError
void write_exposures(const std::filesystem::path& path, const Exposures& exposures);

/// Reads the file. @throws InputError if it cannot be read or is damaged
Exposures read_exposures(const std::filesystem::path& path);

}  // namespace b3dgs
