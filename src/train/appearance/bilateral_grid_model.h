// A bilateral grid of affine colour transforms for each photograph (--bilateral_grid; bilateral_grid_args.h). Unlike
// one transform for the whole image, it can follow vignetting, local tone mapping and glare.
#pragma once

#include <vector>

#include "train/appearance/appearance_model.h"
#include "train/appearance/bilateral_grid_args.h"

namespace b3dgs {

class BilateralGridModel final : public AppearanceModel {
 public:
  BilateralGridModel(const TrainConfig& config, std::int64_t n_views, torch::Device device);

  bool fits(const AppearanceState& state) const override;
  AppearanceState make_state() const override;
  void begin_step(std::int32_t view, int iteration, AppearanceState& state) override;
  torch::Tensor apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) override;
  /// Adds the total variation of the view's grid to the loss.
  void backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                torch::Tensor grad) override;
  torch::Tensor grad() const override { return grid_grad(); }
  void step(std::int32_t view, int iteration, AppearanceState& state) override;

  /// Rises linearly from a hundredth of 0.002 in the first thirtieth of all iterations, and falls
  /// log-linearly to a hundredth at the end; both factors apply throughout.
  double rate(int iteration) const;

  /// dL/d(grid) of the last backward(), [levels, height, width, 12].
  const torch::Tensor& grid_grad() const { return grid_grads_.at(place()); }

 private:
  double variation_weight_;
  int iterations_;
  std::int64_t n_views_;
  torch::Device device_;
  torch::Tensor corrected_, corrected_room_, cell_sums_;
  std::vector<torch::Tensor> grid_grads_;  // by place
  torch::Tensor no_grad_;                  // on a CPU: zeros
};

}  // namespace b3dgs
