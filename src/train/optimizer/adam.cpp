// Adam on the CPU, in one memory-bound pass over parameter, gradient and moments. The blocks have a fixed size in whole
// vectors, and the last few floats use the same instructions as all others, so results do not depend on the number of
// threads.

#include "train/optimizer/adam.h"

#include "core/check.h"
#include "core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "train/optimizer/adam.cpp"
#include <hwy/foreach_target.h>
// Highway requires this after foreach_target.h.
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace b3dgs::cpu::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

template <class Tag>
HWY_INLINE void step_vector(Tag d, const AdamArgs& args, const AdamRule& rule, float* param, const float* grad,
                            float* m, float* v) {
  const auto g = hn::LoadU(d, grad);
  const auto old_m = hn::LoadU(d, m), old_v = hn::LoadU(d, v);
  const auto beta1 = hn::Set(d, rule.beta1), beta2 = hn::Set(d, rule.beta2);
  const auto rest1 = hn::Set(d, rule.rest1), rest2 = hn::Set(d, rule.rest2);
  const auto new_m = hn::MulAdd(beta1, old_m, hn::Mul(rest1, g));
  const auto new_v = hn::MulAdd(beta2, old_v, hn::Mul(rest2, hn::Mul(g, g)));
  const auto divisor = hn::MulAdd(hn::Sqrt(new_v), hn::Set(d, args.size.inverse_root_bias2), hn::Set(d, rule.epsilon));
  const auto change = hn::Div(hn::Mul(hn::Set(d, args.size.step_size), new_m), divisor);
  hn::StoreU(new_m, d, m);
  hn::StoreU(new_v, d, v);
  hn::StoreU(hn::Sub(hn::LoadU(d, param), change), d, param);
}

}  // namespace

/// Steps floats [begin, end). `begin` is a multiple of every vector length.
void adam_range(const AdamArgs& args, const AdamRule& rule, std::int64_t begin, std::int64_t end) {
  const hn::ScalableTag<float> d;
  const auto lanes = static_cast<std::int64_t>(hn::Lanes(d));
  std::int64_t i = begin;
  for (; i + lanes <= end; i += lanes) {
    step_vector(d, args, rule, args.param + i, args.grad + i, args.m + i, args.v + i);
  }
  if (i == end) return;
  HWY_ALIGN float param[hn::MaxLanes(d)] = {}, grad[hn::MaxLanes(d)] = {}, m[hn::MaxLanes(d)] = {},
                  v[hn::MaxLanes(d)] = {};
  const std::int64_t left = end - i;
  std::copy_n(args.param + i, left, param);
  std::copy_n(args.grad + i, left, grad);
  std::copy_n(args.m + i, left, m);
  std::copy_n(args.v + i, left, v);
  step_vector(d, args, rule, param, grad, m, v);
  std::copy_n(param, left, args.param + i);
  std::copy_n(m, left, args.m + i);
  std::copy_n(v, left, args.v + i);
}

}  // namespace b3dgs::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
namespace cpu {

HWY_EXPORT(adam_range);

void adam_step(const AdamArgs& args, const AdamRule& rule) {
  constexpr std::int64_t kBlock =
      1 << 15;  // floats; large enough to hide the overhead of the pool, small enough to balance it
  parallel_pool((args.n + kBlock - 1) / kBlock, [&](std::int64_t block, int) {
    HWY_DYNAMIC_DISPATCH(adam_range)(args, rule, block * kBlock, std::min((block + 1) * kBlock, args.n));
  });
}

}  // namespace cpu

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
  const AdamRule rule = adam_rule(n_views);
  for (std::size_t i = 0; i < groups.size(); ++i) {
    check_is_like(*grads.all()[i], *gaussians.all()[i], i);
    groups[i].grad = grads.all()[i]->data_ptr<float>();
    cpu::adam_step(groups[i], rule);
  }
}

}  // namespace b3dgs
#endif  // HWY_ONCE
