#include "train/appearance/appearance_model.h"

#include "core/check.h"
#include "raster/torch/tensors.h"

namespace b3dgs {

std::unique_ptr<AppearanceModel> make_appearance_model(const TrainConfig& config, std::int64_t n_views,
                                                       torch::Device device) {
  if (config.bilateral_grid) return std::make_unique<BilateralGridModel>(config, n_views, device);
  if (config.exposure) return std::make_unique<ExposureModel>(config, n_views, device);
  return nullptr;
}

AppearanceModel::AppearanceModel(const TrainConfig& config, std::int64_t n_views, torch::Device device,
                                 torch::Tensor AppearanceState::*transforms, torch::IntArrayRef of_view)
    : config_(config), device_(device), transforms_(transforms), n_views_(n_views) {
  for (int place = 0; place < config.batch; ++place) {
    grads_.push_back(torch::zeros(of_view, torch::TensorOptions(torch::kFloat32).device(device)));
  }
}

bool AppearanceModel::fits(const AppearanceState& state) const {
  const torch::Tensor& own = state.*transforms_;
  return own.defined() && own.size(0) == n_views_;
}

AppearanceState AppearanceModel::make_state() const {
  std::vector<std::int64_t> shape = grad().sizes().vec();
  shape.insert(shape.begin(), n_views_);
  const torch::Tensor same = torch::eye(3, 4, grad().options()).flatten();
  AppearanceState state;
  torch::Tensor& own = state.*transforms_;
  own = same.repeat({n_views_ * grad().numel() / same.numel()}).view(shape);
  state.m = torch::zeros_like(own);
  state.v = torch::zeros_like(own);
  if (state.grids.defined()) state.last_steps.assign(static_cast<std::size_t>(n_views_), 0);
  return state;
}

const float* AppearanceModel::transforms_of(const AppearanceState& state, std::int32_t view) const {
  B3DGS_CHECK(view >= 0 && fits(state) && view < n_views_, "view ", view, " of ", n_views_);
  return (state.*transforms_).data_ptr<float>() + view * grad().numel();
}

float* AppearanceModel::make_room(const torch::Tensor& rendered) {
  place_tensor(corrected_, corrected_room_, rendered.sizes(), rendered.options());
  return corrected_.data_ptr<float>();
}

}  // namespace b3dgs
