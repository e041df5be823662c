#include "train/density/strategies/strategies.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/math/opacity.h"
#include "raster/torch/torch_cuda.h"
#include "train/density/density_kernels.h"

namespace b3dgs {
namespace {

constexpr double kSplitShrink = 0.8 * kSplitSamples;  // divisor of the scales
constexpr double kResetOpacity = 0.01;

/// The `room` candidates with the largest gradients; `n_over_limit` is set to the number of the others.
torch::Tensor strongest(const torch::Tensor& candidates, const torch::Tensor& gradients, std::int64_t room,
                        std::int64_t& n_over_limit) {
  const torch::Tensor rows = rows_of(candidates);
  n_over_limit = std::max<std::int64_t>(0, rows.size(0) - room);
  if (n_over_limit == 0) return candidates;
  const torch::Tensor order =
      std::get<1>(torch::sort(gradients.index_select(0, rows), /*stable=*/true, /*dim=*/0, /*descending=*/true));
  torch::Tensor chosen = torch::zeros_like(candidates);
  chosen.index_fill_(0, rows.index_select(0, order.slice(0, 0, room)), 1);
  return chosen;
}

/// One sample of each Gaussian in `rows`: [n, 3], world, on their device.
torch::Tensor sample_means(const GaussianTensors& gaussians, const torch::Tensor& rows, int sample, std::int64_t seed,
                           int iteration) {
  B3DGS_CHECK(gaussians.means.is_contiguous() && gaussians.log_scales.is_contiguous() &&
                  gaussians.quats.is_contiguous() && rows.is_contiguous(),
              "split samples need contiguous tensors");
  torch::Tensor samples = torch::empty({rows.size(0), 3}, gaussians.means.options());
  SplitSampleArgs args;
  args.n_rows = rows.size(0);
  args.rows = rows.data_ptr<std::int64_t>();
  args.means = gaussians.means.data_ptr<float>();
  args.log_scales = gaussians.log_scales.data_ptr<float>();
  args.quats = gaussians.quats.data_ptr<float>();
  args.key = {seed, RandomStream::kSplit, static_cast<std::uint32_t>(iteration)};
  args.sample = sample;
  args.out = samples.data_ptr<float>();
  for_rows<draw_split_sample>(samples.is_cuda(), args, args.n_rows);
  return samples;
}

class DefaultStrategy final : public DensityStrategy {
 public:
  DefaultStrategy(const TrainConfig& config, double extent) : config_(config), extent_(extent) {}

  DensityPlan plan(int iteration) const override { return density_plan(config_, iteration); }

  void after_view(const DensityView& seen, DensityStatistics& statistics) const override {
    add_view(seen.view, seen.width, seen.height, statistics);
  }

  DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics& statistics, int iteration,
                          std::int64_t max_gaussians) const override {
    DensityRule rule = density_rule(config_, extent_, iteration);
    rule.max_gaussians = max_gaussians;
    return densify(gaussians, statistics, rule, config_.seed, iteration);
  }

  void lower_opacities(GaussianTensors& gaussians, AdamState& adam) const override { reset_opacities(gaussians, adam); }

  bool is_recovering(int iteration) const override { return is_after_opacity_reset(config_, iteration); }

 private:
  const TrainConfig config_;
  const double extent_;
};

}  // namespace

std::unique_ptr<DensityStrategy> make_default_strategy(const TrainConfig& config, double extent) {
  return std::make_unique<DefaultStrategy>(config, extent);
}

DensityPlan density_plan(const TrainConfig& config, int iteration) {
  DensityPlan plan;
  if (iteration >= config.densify_until_iter) return plan;
  plan.statistics = true;
  plan.densify = iteration > config.densify_from_iter && iteration % config.densification_interval == 0;
  plan.lower_opacities = iteration % config.opacity_reset_interval == 0 ||
                         (config.white_background && iteration == config.densify_from_iter);
  return plan;
}

bool is_after_opacity_reset(const TrainConfig& config, int iteration) {
  // A reset lowers logits to -4.6 and zeroes their moments, but not Adam's step count: updates are then up to 6.6 times
  // --opacity_lr, and fall to about 1.6 times after 500 steps. By then most opacities have recovered.
  constexpr int kRecovery = 500;
  for (int i = std::max(1, iteration - std::min(kRecovery, config.opacity_reset_interval / 2)); i < iteration; ++i) {
    if (density_plan(config, i).lower_opacities) return true;
  }
  return false;
}

DensityRule density_rule(const TrainConfig& config, double extent, int iteration) {
  constexpr double kPruneWorldSize = 0.1;  // of the scene extent
  const bool prunes_large = iteration > config.opacity_reset_interval;
  DensityRule rule;
  rule.grad_threshold = config.densify_grad_threshold;
  rule.split_scale = config.percent_dense * extent;
  rule.prune_opacity = config.prune_opacity;
  rule.prune_scale = prunes_large ? kPruneWorldSize * extent : 0;
  rule.prune_radius = prunes_large ? config.prune_screen_size : 0;
  rule.max_gaussians = config.max_gaussians;
  return rule;
}

DensityRound densify(const GaussianTensors& gaussians, const DensityStatistics& statistics, const DensityRule& rule,
                     std::int64_t seed, int iteration) {
  const std::int64_t n = gaussians.size();
  DensityRound round;
  // The thresholds are converted to the stored form (log scale, logit), not the parameters: comparisons are exact.
  const torch::Tensor largest = gaussians.log_scales.amax(1);
  const torch::Tensor gradients = statistics.grad_norm_sum / statistics.view_count.clamp_min(1);
  torch::Tensor grows = (gradients >= rule.grad_threshold).logical_and_(statistics.view_count > 0);
  if (rule.max_gaussians > 0) {
    grows = strongest(grows, gradients, std::max<std::int64_t>(0, rule.max_gaussians - n), round.n_over_limit);
  }
  const torch::Tensor is_large = largest > std::log(rule.split_scale);
  const torch::Tensor cloned = rows_of(grows.logical_and(is_large.logical_not()));
  const torch::Tensor split = rows_of(grows.logical_and(is_large));

  // Whether a row would be pruned if its scales were divided by `shrink`. Copies have their source's opacity.
  const auto is_pruned = [&](double shrink) {
    torch::Tensor pruned = gaussians.logit_opacities < logit(rule.prune_opacity);
    if (rule.prune_scale > 0) pruned.logical_or_(largest > std::log(rule.prune_scale * shrink));
    return pruned;
  };
  const torch::Tensor copy_stays = is_pruned(1).logical_not();
  const torch::Tensor part_stays = is_pruned(kSplitShrink).logical_not();
  torch::Tensor stays = copy_stays;
  if (rule.prune_radius > 0) stays = stays.logical_and(statistics.max_radii <= rule.prune_radius);
  stays = stays.clone();
  stays.index_fill_(0, split, 0);

  const torch::Tensor kept = rows_of(stays);
  const torch::Tensor copies = cloned.index_select(0, rows_of(copy_stays.index_select(0, cloned)));
  const torch::Tensor parts = split.index_select(0, rows_of(part_stays.index_select(0, split)));

  std::vector<torch::Tensor> sources{kept, copies}, means{gaussians.means.index_select(0, copies)},
      log_scales{gaussians.log_scales.index_select(0, copies)};
  for (int sample = 0; sample < kSplitSamples; ++sample) {
    sources.push_back(parts);
    means.push_back(sample_means(gaussians, parts, sample, seed, iteration));
    log_scales.push_back(gaussians.log_scales.index_select(0, parts) - std::log(kSplitShrink));
  }
  round.edit.sources = torch::cat(sources);
  round.edit.n_kept = kept.size(0);
  round.edit.new_means = torch::cat(means);
  round.edit.new_log_scales = torch::cat(log_scales);
  round.n_cloned = cloned.size(0);
  round.n_split = split.size(0);
  round.n_pruned = n + round.n_cloned + (kSplitSamples - 1) * round.n_split - round.edit.sources.size(0);
  return round;
}

void reset_opacities(GaussianTensors& gaussians, AdamState& adam) {
  gaussians.logit_opacities.clamp_max_(logit(kResetOpacity));
  adam.m.logit_opacities.zero_();
  adam.v.logit_opacities.zero_();
}

}  // namespace b3dgs
