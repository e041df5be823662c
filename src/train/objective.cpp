#include "train/objective.h"

#include "train/optimizer/adam.h"

namespace b3dgs {

Objective::Objective(const TrainConfig& config, const Scene& scene, torch::Device device, const ProgressFn& progress)
    : config_(config), loss_(device) {
  if (config.exposure || config.bilateral_grid) {
    appearance_.emplace(config, static_cast<std::int64_t>(scene.train.size()), device);
  }
  if (uses_depths(config)) depth_priors_.emplace(config.depths, scene, device, progress);
}

std::vector<std::string> Objective::warnings() const {
  return depth_priors_ ? depth_priors_->warnings() : std::vector<std::string>{};
}

std::int64_t Objective::bytes_per_pixel() const {
  constexpr std::int64_t kFloat = sizeof(float), kRendered = 5 * kFloat;  // colour, depth, alpha
  std::int64_t bytes = kRendered + ImageLoss::kBytesPerPixel;
  if (appearance_) bytes += 3 * kFloat;                        // colours of the photograph's camera
  if (depth_priors_) bytes += kFloat + 2;                      // gradient, and the depth map of 16 bits
  if (config_.strategy == Strategy::kBudget) bytes += kFloat;  // errors
  if (loss_weights(config_).alpha > 0) bytes += kFloat;        // gradient with respect to alpha
  return bytes;
}

RenderedViewGrad Objective::gradient(const TrainView& view, int iteration, const torch::Tensor& full_valid,
                                     const RenderedView& rendered, bool wants_errors, AppearanceState& appearance) {
  torch::Tensor color = rendered.color;
  if (appearance_) {
    appearance_->begin_step(view.index, iteration, appearance);
    appearance_->set_photograph(view.truth);
    color = appearance_->apply(appearance, view.index, rendered.color);
  }
  const LossWeights weights = loss_weights(config_);
  loss_.compute(color, view.truth, view.valid, view.n_valid, weights);
  if (view.empty.defined() && weights.alpha > 0) loss_.add_alpha(rendered.alpha, view.empty, weights.alpha);
  if (wants_errors) error_image_.compute(color, view.truth, view.valid);
  RenderedViewGrad grad = loss_.grad();
  if (appearance_) appearance_->backward(appearance, view.index, rendered.color, grad.color);
  if (depth_priors_ && depth_priors_->has(view.index)) {
    const double weight =
        log_linear_rate(config_.depth_l1_weight_init, config_.depth_l1_weight_final, config_.iterations, iteration);
    grad.depth = depth_priors_->gradient(view.index, rendered.depth, view.valid, view.n_valid, full_valid, weight);
  }
  return grad;
}

}  // namespace b3dgs
