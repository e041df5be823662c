#include "app/terminal/eta.h"

#include <algorithm>
#include <cmath>

namespace b3dgs {
namespace {

constexpr std::size_t kSamplesKept = 80;
constexpr std::size_t kSpeedSamples = 5;
constexpr int kLargestSpacing = 25;       // iterations; 80 samples then cover 20 rounds of densification
constexpr int kSmallestGrowthSpan = 100;  // iterations; a shorter span may lie between two rounds of densification

/// Seconds per iteration = constant + slope * count.
struct StepTime {
  double constant = 0, slope = 0;
};

/// Least-squares fit over the intervals between samples. If the count hardly varies, the data do not determine both
/// constant and slope; a weak prior then attributes half of the time to each.
StepTime fit_step_time(const std::deque<EtaSample>& samples) {
  double weight = 0, mean_time = 0, mean_count = 0;
  const auto for_each_interval = [&](auto&& body) {
    for (std::size_t k = 1; k < samples.size(); ++k) {
      const double steps = samples[k].iteration - samples[k - 1].iteration;
      if (steps <= 0) continue;
      const double count = 0.5 * static_cast<double>(samples[k].n_gaussians + samples[k - 1].n_gaussians);
      body(steps, (samples[k].elapsed_s - samples[k - 1].elapsed_s) / steps, count);
    }
  };
  for_each_interval([&](double steps, double time, double count) {
    weight += steps;
    mean_time += steps * time;
    mean_count += steps * count;
  });
  if (weight == 0) return {};
  mean_time /= weight;
  mean_count /= weight;
  if (mean_count <= 0) return {mean_time, 0};

  double variance = 0, covariance = 0;
  for_each_interval([&](double steps, double time, double count) {
    variance += steps / weight * (count - mean_count) * (count - mean_count);
    covariance += steps / weight * (count - mean_count) * (time - mean_time);
  });
  const double prior_weight = 0.0025 * mean_count * mean_count;  // equivalent to a variation of the count by 5 %
  const double prior_slope = 0.5 * mean_time / mean_count;
  StepTime fit;
  fit.slope = (covariance + prior_weight * prior_slope) / (variance + prior_weight);
  fit.slope = std::clamp(fit.slope, 0.0, mean_time / mean_count);  // both parts are at least 0
  fit.constant = mean_time - fit.slope * mean_count;
  return fit;
}

}  // namespace

std::optional<Eta> estimate_eta(const std::deque<EtaSample>& samples, const EtaPlan& plan) {
  if (samples.size() < 2 || samples.back().iteration <= samples.front().iteration) return std::nullopt;
  const EtaSample& now = samples.back();
  const double steps_left = std::max(0, plan.iterations - now.iteration);
  const int growth_end = std::min(plan.densify_until, plan.iterations);

  // Growth per iteration, from the samples taken during density control.
  double growth = 0;
  bool growth_is_known = now.iteration >= growth_end || plan.densify_from >= growth_end;
  const auto first = std::find_if(samples.begin(), samples.end(),
                                  [&](const EtaSample& sample) { return sample.iteration >= plan.densify_from; });
  if (!growth_is_known && first != samples.end() && now.iteration - first->iteration >= kSmallestGrowthSpan) {
    growth_is_known = true;
    growth = static_cast<double>(now.n_gaussians - first->n_gaussians) / (now.iteration - first->iteration);
    growth = std::max(0.0, growth);
  }

  // Sum of the count over the remaining iterations: it grows until density control ends or the limit is reached.
  const double count = static_cast<double>(now.n_gaussians);
  double growing = std::max(0, growth_end - now.iteration);
  if (plan.max_gaussians > 0 && growth > 0) {
    growing = std::min(growing, std::max(0.0, (static_cast<double>(plan.max_gaussians) - count) / growth));
  }
  const double count_sum = count * steps_left + growth * growing * (0.5 * growing + (steps_left - growing));

  const StepTime step = fit_step_time(samples);
  return Eta{step.constant * steps_left + step.slope * count_sum, !growth_is_known || now.view_scale > 1};
}

void EtaHistory::add(const EtaSample& sample) {
  const int spacing = std::clamp(plan_.iterations / 200, 1, kLargestSpacing);
  if (!samples_.empty() && samples_.back().view_scale != sample.view_scale) samples_.clear();
  // The newest sample is always kept. The one before it is dropped if it is too close to its predecessor.
  const std::size_t n = samples_.size();
  if (n >= 2 && samples_[n - 1].iteration < samples_[n - 2].iteration + spacing) samples_.pop_back();
  samples_.push_back(sample);
  if (samples_.size() > kSamplesKept) samples_.pop_front();
}

double EtaHistory::iterations_per_second() const {
  if (samples_.size() < 2) return 0;
  const EtaSample& then = samples_[samples_.size() - std::min(samples_.size(), kSpeedSamples + 1)];
  const double seconds = samples_.back().elapsed_s - then.elapsed_s;
  return seconds > 0 ? (samples_.back().iteration - then.iteration) / seconds : 0;
}

}  // namespace b3dgs
