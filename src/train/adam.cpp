// From tensors to AdamArgs.

#include "train/adam.h"

#include <cmath>

#include "check.h"

namespace b3dgs {
namespace {

void check_is_like(const torch::Tensor& other, const torch::Tensor& param, std::size_t group) {
  B3DGS_CHECK(other.defined() && other.sizes() == param.sizes() && other.is_contiguous() &&
                  other.device() == param.device() && other.scalar_type() == torch::kFloat32,
              GaussianTensors::kNames[group], " is ", param.sizes(), "; gradient or moments are not like it");
}

}  // namespace

AdamState make_adam_state(const GaussianTensors& gaussians) {
  AdamState state;
  for (std::size_t i = 0; i < gaussians.all().size(); ++i) {
    *state.m.all()[i] = torch::zeros_like(*gaussians.all()[i]);
    *state.v.all()[i] = torch::zeros_like(*gaussians.all()[i]);
  }
  return state;
}

AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state) {
  ++state.steps;
  const double t = static_cast<double>(state.steps);
  const double bias1 = 1 - std::pow(kAdamBeta1, t), bias2 = 1 - std::pow(kAdamBeta2, t);
  AdamGroups groups;
  for (std::size_t i = 0; i < groups.size(); ++i) {
    const torch::Tensor &param = *gaussians.all()[i], &m = *state.m.all()[i], &v = *state.v.all()[i];
    for (const torch::Tensor* other : {&param, &m, &v}) check_is_like(*other, param, i);
    groups[i].n = param.numel();
    groups[i].param = param.data_ptr<float>();
    groups[i].m = m.data_ptr<float>();
    groups[i].v = v.data_ptr<float>();
    groups[i].step_size = static_cast<float>(rates[i] / bias1);
    groups[i].inverse_root_bias2 = static_cast<float>(1 / std::sqrt(bias2));
  }
  return groups;
}

void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state) {
  B3DGS_CHECK(gaussians.means.is_cpu(), "Adam alone on ", gaussians.means.device());
  AdamGroups groups = begin_adam_step(rates, gaussians, state);
  for (std::size_t i = 0; i < groups.size(); ++i) {
    check_is_like(*grads.all()[i], *gaussians.all()[i], i);
    groups[i].grad = grads.all()[i]->data_ptr<float>();
    cpu::adam_step(groups[i]);
  }
}

}  // namespace b3dgs
