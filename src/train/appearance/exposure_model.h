// An affine transform of the colours of each photograph (--exposure), as in the original 3DGS code: Adam with its own
// learning rate, from the identity.
#pragma once

#include <vector>

#include "train/appearance/appearance_model.h"

namespace b3dgs {

class ExposureModel final : public AppearanceModel {
 public:
  /// The learning rate falls log-linearly from config.exposure_lr_init to exposure_lr_final in the last iteration.
  ExposureModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  bool fits(const AppearanceState& state) const override;
  AppearanceState make_state() const override;
  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) override;
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                torch::Tensor grad) override;
  torch::Tensor grad() const override { return transform_grad(); }
  void step(std::int32_t view, int iteration, AppearanceState& state) override;

  /// dL/d(transform) of the last backward(), [3, 4].
  const torch::Tensor& transform_grad() const { return transform_grads_.at(place()); }

 private:
  double lr_init_, lr_final_;
  int iterations_;
  std::int64_t n_views_;
  torch::Device device_;
  torch::Tensor corrected_, corrected_room_, block_sums_;
  std::vector<torch::Tensor> transform_grads_;  // by place
  torch::Tensor all_grads_;                     // on a CPU: [V, 3, 4], 0 between steps
};

}  // namespace b3dgs
