#include "train/density/strategies/strategies.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "raster/math/opacity.h"
#include "raster/torch/torch_cuda.h"
#include "train/density/density_kernels.h"

namespace b3dgs {
namespace {

constexpr double kSplitShrink = 0.8 * kSplitSamples;  // divisor of the scales
constexpr double kPruneWorldSize = 0.1;               // larger Gaussians are pruned; fraction of the scene extent

/// Returns the `room` candidates with the largest gradients. `n_over_limit` receives the number of the others.
torch::Tensor strongest(const torch::Tensor& candidates, const torch::Tensor& gradients, std::int64_t room,
                        std::int64_t& n_over_limit) {
  const torch::Tensor rows = rows_of(candidates);
  n_over_limit = std::max<std::int64_t>(0, rows.size(0) - room);
  if (n_over_limit == 0) return candidates;
  return torch::zeros_like(candidates).index_fill_(0, largest_rows(rows, gradients.index_select(0, rows), room), 1);
}

/// Returns one sample of each Gaussian in `rows`, [n, 3] in world space, on their device.
torch::Tensor sample_means(const GaussianTensors& gaussians, const torch::Tensor& rows, int sample, std::int64_t seed,
                           int iteration) {
  torch::Tensor samples = torch::empty({rows.size(0), 3}, gaussians.means.options());
  SplitSampleArgs args;
  args.rows = rows.data_ptr<std::int64_t>();
  args.gaussians = arrays_without_colors(gaussians);
  args.key = {seed, RandomStream::kSplit, static_cast<std::uint32_t>(iteration)};
  args.sample = sample;
  args.out = samples.data_ptr<float>();
  for_rows<draw_split_sample>(samples.is_cuda(), args, rows.size(0));
  return samples;
}

/// Adaptive density control of the original 3DGS (Kerbl et al. 2023, section 5).
class DefaultStrategy final : public DensityStrategy {
 public:
  using DensityStrategy::DensityStrategy;

  /// Returns the plan of the original's schedule.
  DensityPlan plan(int iteration) const override {
    DensityPlan plan;
    if (iteration >= config_.densify_until_iter) return plan;
    plan.statistics = true;
    plan.densify = is_growth_round(config_, iteration);
    plan.lower_opacities = iteration % config_.opacity_reset_interval == 0 ||
                           (config_.white_background && iteration == config_.densify_from_iter);
    return plan;
  }

  void after_view(const DensityView& seen, DensityStatistics& statistics) const override {
    AddViewArgs args;
    args.means2d_grad = seen.view.means2d_grad.data_ptr<float>();
    args.radii = seen.view.radii.data_ptr<std::int32_t>();
    args.half_width = 0.5f * static_cast<float>(seen.width);
    args.half_height = 0.5f * static_cast<float>(seen.height);
    args.grad_norm_sum = statistics.grad_norm_sum.data_ptr<float>();
    args.view_count = statistics.view_count.data_ptr<std::int32_t>();
    args.max_radii = statistics.max_radii.data_ptr<std::int32_t>();
    for_rows<add_view_row>(seen.view.radii.is_cuda(), args, seen.view.radii.numel());
  }

  /// Proceeds in the order of the original. Small Gaussians with large gradients are cloned (exact copies), large ones
  /// are split (two samples of the parent replace it, 1.6 times smaller), and then old and new Gaussians are pruned.
  /// Clones of this round are not split. If there are more candidates than max_gaussians allows, those with the largest
  /// gradients are taken, and the first among equals. The samples do not depend on the number of threads.
  DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics& statistics, int iteration,
                          std::int64_t max_gaussians) const override {
    const std::int64_t n = gaussians.size();
    const bool prunes_large = iteration > config_.opacity_reset_interval;
    DensityRound round;
    // Thresholds are converted to the stored form (log scale, logit) instead of converting the parameters, so that
    // comparisons are exact.
    const torch::Tensor largest = gaussians.log_scales.amax(1);
    const torch::Tensor gradients = statistics.grad_norm_sum / statistics.view_count.clamp_min(1);
    torch::Tensor grows = (gradients >= config_.densify_grad_threshold).logical_and_(statistics.view_count > 0);
    if (max_gaussians > 0) {
      grows = strongest(grows, gradients, std::max<std::int64_t>(0, max_gaussians - n), round.n_over_limit);
    }
    const torch::Tensor is_large = largest > std::log(config_.percent_dense * extent_);
    const torch::Tensor cloned = rows_of(grows.logical_and(is_large.logical_not()));
    const torch::Tensor split = rows_of(grows.logical_and(is_large));

    // Returns which rows would be pruned if their scales were divided by `shrink`. Copies have the opacity of their
    // source.
    const auto is_pruned = [&](double shrink) {
      torch::Tensor pruned = gaussians.logit_opacities < logit(config_.prune_opacity);
      if (prunes_large && extent_ > 0) pruned.logical_or_(largest > std::log(kPruneWorldSize * extent_ * shrink));
      return pruned;
    };
    const torch::Tensor copy_stays = is_pruned(1).logical_not();
    const torch::Tensor part_stays = is_pruned(kSplitShrink).logical_not();
    torch::Tensor stays = copy_stays;
    if (prunes_large && config_.prune_screen_size > 0) {
      stays = stays.logical_and(statistics.max_radii <= config_.prune_screen_size);
    }
    stays = stays.clone();
    stays.index_fill_(0, split, 0);

    const torch::Tensor kept = rows_of(stays);
    const torch::Tensor copies = cloned.index_select(0, rows_of(copy_stays.index_select(0, cloned)));
    const torch::Tensor parts = split.index_select(0, rows_of(part_stays.index_select(0, split)));

    std::vector<torch::Tensor> sources{kept, copies}, means{gaussians.means.index_select(0, copies)},
        log_scales{gaussians.log_scales.index_select(0, copies)};
    for (int sample = 0; sample < kSplitSamples; ++sample) {
      sources.push_back(parts);
      means.push_back(sample_means(gaussians, parts, sample, config_.seed, iteration));
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

  /// Limits opacities to 0.01 and sets their Adam moments to 0. Adam's step count, which all parameters share, stays
  /// unchanged, as in the original. Updates of opacities are never deferred, so no flush is needed.
  void lower_opacities(GaussianTensors& gaussians, AdamState& adam) const override {
    constexpr double kResetOpacity = 0.01;
    gaussians.logit_opacities.clamp_max_(logit(kResetOpacity));
    adam.m.logit_opacities.zero_();
    adam.v.logit_opacities.zero_();
  }
};

}  // namespace

std::unique_ptr<DensityStrategy> make_default_strategy(const TrainConfig& config, double extent) {
  return std::make_unique<DefaultStrategy>(config, extent);
}

}  // namespace b3dgs
