#include "train/optimizer/adam.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/parallel.h"
#include "support/approx.h"

namespace b3dgs {
namespace {

GaussianTensors random_tensors(std::int64_t n) {
  return {torch::randn({n, 3}), torch::randn({n, 3}),    torch::randn({n, 4}),
          torch::randn({n}),    torch::randn({n, 1, 3}), torch::randn({n, 15, 3})};
}

TEST(Adam, EqualsTheFormulasInDouble) {
  torch::manual_seed(1);
  GaussianTensors gaussians = random_tensors(37);  // no group is a multiple of the vector length
  const AdamRates rates{0.1, 0.02, 0.003, 0.04, 0.005, 0.006};
  std::array<torch::Tensor, 6> param, m, v;
  for (std::size_t i = 0; i < 6; ++i) {
    param[i] = gaussians.all()[i]->to(torch::kFloat64);
    m[i] = torch::zeros_like(param[i]);
    v[i] = torch::zeros_like(param[i]);
  }
  AdamState state = make_adam_state(gaussians);
  for (int step = 1; step <= 25; ++step) {
    const GaussianTensors grads = random_tensors(37);
    adam_step(rates, grads, gaussians, state);
    for (std::size_t i = 0; i < 6; ++i) {
      auto grad = grads.all()[i]->to(torch::kFloat64).flatten();
      auto p = param[i].flatten(), pm = m[i].flatten(), pv = v[i].flatten();
      for (std::int64_t j = 0; j < p.numel(); ++j) {
        const double g = grad.data_ptr<double>()[j];
        double &one = pm.data_ptr<double>()[j], &two = pv.data_ptr<double>()[j];
        one = 0.9 * one + 0.1 * g;
        two = 0.999 * two + 0.001 * g * g;
        const double corrected1 = one / (1 - std::pow(0.9, step)), corrected2 = two / (1 - std::pow(0.999, step));
        p.data_ptr<double>()[j] -= rates[i] * corrected1 / (std::sqrt(corrected2) + 1e-15);
      }
    }
  }
  EXPECT_EQ(state.steps, 25);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_TRUE(test::within(*gaussians.all()[i], param[i], 2e-6)) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::within(*state.m.all()[i], m[i], 1e-6)) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::within(*state.v.all()[i], v[i], 1e-7)) << GaussianTensors::kNames[i];
  }
}

TEST(Adam, FirstStepHasTheSizeOfTheRateForAnyGradient) {
  GaussianTensors gaussians = random_tensors(5);
  const GaussianTensors before = [&] {
    GaussianTensors copy;
    for (std::size_t i = 0; i < 6; ++i) *copy.all()[i] = gaussians.all()[i]->clone();
    return copy;
  }();
  GaussianTensors grads = random_tensors(5);
  grads.means.fill_(-1e-9f);  // typical of a mean over a million pixels
  AdamState state = make_adam_state(gaussians);
  adam_step({0.01, 0, 0, 0, 0, 0}, grads, gaussians, state);
  EXPECT_TRUE(test::within(gaussians.means - before.means, torch::full({5, 3}, 0.01), 1e-6));
  EXPECT_TRUE(test::same(gaussians.quats, before.quats)) << "rate 0";
}

TEST(Adam, DoesNotChangeRowsThatNeverHadAGradient) {
  GaussianTensors gaussians = random_tensors(20), grads = random_tensors(20);
  const torch::Tensor before = gaussians.shN.clone();
  grads.shN.zero_();
  AdamState state = make_adam_state(gaussians);
  adam_step({1, 1, 1, 1, 1, 1}, grads, gaussians, state);
  EXPECT_TRUE(test::same(gaussians.shN, before));
}

TEST(Adam, IsTheSameForAnyNumberOfThreads) {
  torch::manual_seed(2);
  const std::int64_t n = 3001;  // shN has several blocks and a partial one
  const GaussianTensors start = random_tensors(n), grads = random_tensors(n);
  const auto shN_after = [&](int threads) {
    set_thread_count(threads);
    GaussianTensors gaussians;
    for (std::size_t i = 0; i < 6; ++i) *gaussians.all()[i] = start.all()[i]->clone();
    AdamState state = make_adam_state(gaussians);
    for (int step = 0; step < 3; ++step) adam_step({1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2}, grads, gaussians, state);
    set_thread_count(0);
    return gaussians.shN;
  };
  const torch::Tensor one = shN_after(1);
  EXPECT_TRUE(test::same(shN_after(2), one));
  EXPECT_TRUE(test::same(shN_after(5), one));
}

}  // namespace
}  // namespace b3dgs
