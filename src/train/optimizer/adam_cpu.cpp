// Adam on the CPU: one memory-bound pass over parameter, gradient and moments. Blocks have a fixed size in whole
// vectors, and the last few floats use the same instructions as all others, so no value depends on the threads.

#include "train/optimizer/adam.h"

#include "core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "train/optimizer/adam_cpu.cpp"
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

/// Floats [begin, end); begin is a multiple of every vector length.
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
namespace b3dgs::cpu {

HWY_EXPORT(adam_range);

void adam_step(const AdamArgs& args, const AdamRule& rule) {
  constexpr std::int64_t kBlock =
      1 << 15;  // floats: large enough to hide the overhead of the pool, small enough to balance it
  parallel_pool((args.n + kBlock - 1) / kBlock, [&](std::int64_t block, int) {
    HWY_DYNAMIC_DISPATCH(adam_range)(args, rule, block * kBlock, std::min((block + 1) * kBlock, args.n));
  });
}

}  // namespace b3dgs::cpu
#endif  // HWY_ONCE
