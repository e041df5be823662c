// Converts tensors to AdamArgs.

#include "train/optimizer/adam.h"

#include "core/check.h"

namespace b3dgs {
namespace {

void check_is_like(const torch::Tensor& other, const torch::Tensor& param, std::size_t group) {
  B3DGS_CHECK(other.defined() && other.sizes() == param.sizes() && other.is_contiguous() &&
                  other.device() == param.device() && other.scalar_type() == torch::kFloat32,
              GaussianTensors::kNames[group], " has shape ", param.sizes(),
              "; its gradient or moments differ in shape, type, device or layout");
}

}  // namespace

void check_adam_state(const GaussianTensors& gaussians, const AdamState& state) {
  for (std::size_t i = 0; i < gaussians.all().size(); ++i) {
    const torch::Tensor& param = *gaussians.all()[i];
    for (const torch::Tensor* other : {&param, state.m.all()[i], state.v.all()[i]}) check_is_like(*other, param, i);
  }
}

AdamState make_adam_state(const GaussianTensors& gaussians) {
  AdamState state;
  for (std::size_t i = 0; i < gaussians.all().size(); ++i) {
    *state.m.all()[i] = torch::zeros_like(*gaussians.all()[i]);
    *state.v.all()[i] = torch::zeros_like(*gaussians.all()[i]);
  }
  return state;
}

AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, int n_views) {
  state.steps += n_views;
  check_adam_state(gaussians, state);
  AdamGroups groups;
  for (std::size_t i = 0; i < groups.size(); ++i) {
    groups[i].n = gaussians.all()[i]->numel();
    groups[i].param = gaussians.all()[i]->data_ptr<float>();
    groups[i].m = state.m.all()[i]->data_ptr<float>();
    groups[i].v = state.v.all()[i]->data_ptr<float>();
    groups[i].size = adam_step_size(rates[i], state.steps);
  }
  return groups;
}

void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state,
               int n_views) {
  B3DGS_CHECK(gaussians.means.is_cpu(), "adam_step() is for the CPU, found ", gaussians.means.device());
  AdamGroups groups = begin_adam_step(rates, gaussians, state, n_views);
  const AdamRule rule = n_views == 1 ? AdamRule{} : adam_rule(n_views);
  for (std::size_t i = 0; i < groups.size(); ++i) {
    check_is_like(*grads.all()[i], *gaussians.all()[i], i);
    groups[i].grad = grads.all()[i]->data_ptr<float>();
    cpu::adam_step(groups[i], rule);
  }
}

}  // namespace b3dgs
