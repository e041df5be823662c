// From tensors to AdamArgs.

#include "train/adam.h"

#include <array>
#include <cmath>
#include <tuple>

#include "check.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch_launch.h"
#include "train/cuda/adam_cuda.h"
#endif

namespace b3dgs {

AdamState make_adam_state(const GaussianTensors& gaussians) {
  AdamState state;
  for (std::size_t i = 0; i < gaussians.all().size(); ++i) {
    *state.m.all()[i] = torch::zeros_like(*gaussians.all()[i]);
    *state.v.all()[i] = torch::zeros_like(*gaussians.all()[i]);
  }
  return state;
}

void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state) {
  ++state.steps;
  const double t = static_cast<double>(state.steps);
  const double bias1 = 1 - std::pow(kAdamBeta1, t), bias2 = 1 - std::pow(kAdamBeta2, t);
  std::array<AdamArgs, std::tuple_size_v<AdamRates>> groups;
  for (std::size_t i = 0; i < groups.size(); ++i) {
    const torch::Tensor &param = *gaussians.all()[i], &grad = *grads.all()[i], &m = *state.m.all()[i],
                        &v = *state.v.all()[i];
    for (const torch::Tensor* other : {&param, &grad, &m, &v}) {
      B3DGS_CHECK(other->defined() && other->sizes() == param.sizes() && other->is_contiguous() &&
                      other->device() == param.device() && other->scalar_type() == torch::kFloat32,
                  GaussianTensors::kNames[i], " is ", param.sizes(), "; gradient and moments are not like it");
    }
    groups[i].n = param.numel();
    groups[i].param = param.data_ptr<float>();
    groups[i].grad = grad.data_ptr<float>();
    groups[i].m = m.data_ptr<float>();
    groups[i].v = v.data_ptr<float>();
    groups[i].step_size = static_cast<float>(rates[i] / bias1);
    groups[i].inverse_root_bias2 = static_cast<float>(1 / std::sqrt(bias2));
  }
  const torch::Device device = gaussians.means.device();
  if (!device.is_cpu()) {
#if B3DGS_TORCH_CUDA
    return cuda::adam_step(groups, torch_launch_context().stream);
#endif
    input_error("this build has Adam for the CPU only, found device ", device.str(), "; use --device cpu");
  }
  for (const AdamArgs& args : groups) cpu::adam_step(args);
}

}  // namespace b3dgs
