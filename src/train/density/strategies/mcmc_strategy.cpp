#include "train/density/strategies/strategies.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/math/opacity.h"
#include "raster/torch/torch_cuda.h"
#include "train/density/strategies/mcmc_math.h"

namespace b3dgs {
namespace {

/// Returns the weights of all Gaussians in a draw, [N] int64.
torch::Tensor draw_weights(const torch::Tensor& logit_opacities, float dead_logit) {
  torch::Tensor weights = torch::empty(logit_opacities.sizes(), logit_opacities.options().dtype(torch::kInt64));
  const DrawWeightArgs args{logit_opacities.data_ptr<float>(), dead_logit, weights.data_ptr<std::int64_t>()};
  for_rows<write_draw_weight>(weights.is_cuda(), args, weights.size(0));
  return weights;
}

/// Returns indices [n_draws] int64, drawn in proportion to `weights` [N] with the random numbers from `first_number`
/// on.
torch::Tensor draw_rows(const torch::Tensor& weights, std::int64_t n_draws, const RandomKey& key,
                        std::int64_t first_number) {
  const torch::Tensor sums = weights.cumsum(0);
  torch::Tensor rows = torch::empty({n_draws}, weights.options());
  const DrawArgs args{weights.size(0), sums.data_ptr<std::int64_t>(), key, static_cast<std::uint64_t>(first_number),
                      rows.data_ptr<std::int64_t>()};
  for_rows<draw_row>(rows.is_cuda(), args, n_draws);
  return rows;
}

/// Returns how often each row was drawn, [n] int32.
torch::Tensor count_rows(const torch::Tensor& drawn, std::int64_t n) {
  const auto counts = drawn.options().dtype(torch::kInt32);
  return torch::zeros({n}, counts).scatter_add_(0, drawn, torch::ones(drawn.sizes(), counts));
}

/// The parameters in which copies differ from their source.
struct Copies {
  torch::Tensor logit_opacities;  // [n]
  torch::Tensor log_scales;       // [n, 3]
};

/// Returns copies of the rows `rows` [n] of `from` [N]. n_drawn [N] int32 is the number of copies of each Gaussian
/// beside itself. Copies have an opacity logit of at least `least_logit`. Otherwise they could be dead at once, and
/// would be relocated in the next round.
Copies share(const Copies& from, const torch::Tensor& rows, const torch::Tensor& n_drawn, float least_logit) {
  B3DGS_CHECK(from.logit_opacities.is_contiguous() && from.log_scales.is_contiguous() && rows.is_contiguous(),
              "copies need contiguous tensors");
  Copies copies{torch::empty({rows.size(0)}, from.logit_opacities.options()),
                torch::empty({rows.size(0), 3}, from.log_scales.options())};
  const ShareArgs args{rows.data_ptr<std::int64_t>(),
                       n_drawn.data_ptr<std::int32_t>(),
                       from.logit_opacities.data_ptr<float>(),
                       from.log_scales.data_ptr<float>(),
                       copies.logit_opacities.data_ptr<float>(),
                       copies.log_scales.data_ptr<float>()};
  for_rows<share_row>(rows.is_cuda(), args, rows.size(0));
  const torch::Tensor is_copy = n_drawn.index_select(0, rows) > 0;
  copies.logit_opacities = torch::where(is_copy, copies.logit_opacities.clamp_min(least_logit), copies.logit_opacities);
  return copies;
}

class McmcStrategy final : public DensityStrategy {
 public:
  using DensityStrategy::DensityStrategy;

  DensityPlan plan(int iteration) const override {
    DensityPlan plan;
    plan.after_step = config_.noise_lr > 0;
    plan.densify = is_growth_round(config_, iteration);
    return plan;
  }

  void after_step(int iteration, GaussianTensors& gaussians, const torch::Tensor& model_rows) const override {
    if (config_.noise_lr == 0) return;
    add_mean_noise(gaussians, mean_noise_strength(config_, extent_, iteration), config_.seed, iteration, model_rows);
  }

  DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics&, int iteration,
                          std::int64_t max_gaussians) const override {
    constexpr double kGrowth = 0.05;  // as in the paper
    return plan_mcmc_round(gaussians, {config_.prune_opacity, kGrowth, max_gaussians}, config_.seed, iteration);
  }
};

}  // namespace

std::unique_ptr<DensityStrategy> make_mcmc_strategy(const TrainConfig& config, double extent) {
  return std::make_unique<McmcStrategy>(config, extent);
}

DensityRound plan_mcmc_round(const GaussianTensors& gaussians, const McmcRule& rule, std::int64_t seed, int iteration) {
  const std::int64_t n = gaussians.size();
  const RandomKey key{seed, RandomStream::kRelocation, static_cast<std::uint32_t>(iteration)};
  DensityRound round;
  const float dead_logit = logit(rule.prune_opacity);
  const float least_logit = std::nextafter(dead_logit, std::numeric_limits<float>::infinity());
  torch::Tensor weights = draw_weights(gaussians.logit_opacities, dead_logit);
  const torch::Tensor dead = rows_of(weights == 0);
  const std::int64_t n_dead = dead.size(0);
  torch::Tensor sources = torch::arange(n, weights.options());
  if (n_dead == n) {
    round.edit = keep_rows(sources, gaussians.means.options());
    return round;
  }
  // Dead Gaussians become copies of live ones.
  const torch::Tensor replacements = draw_rows(weights, n_dead, key, 0);
  sources.index_copy_(0, dead, replacements);
  const torch::Tensor n_replacements = count_rows(replacements, n);
  const Copies moved = share({gaussians.logit_opacities, gaussians.log_scales}, sources, n_replacements, least_logit);

  // Further copies of the result are added.
  const auto wanted = static_cast<std::int64_t>(rule.growth * static_cast<double>(n));
  const std::int64_t room = rule.max_gaussians > 0 ? std::max<std::int64_t>(0, rule.max_gaussians - n) : wanted;
  const std::int64_t n_added = std::min(wanted, room);
  weights = draw_weights(moved.logit_opacities, -std::numeric_limits<float>::infinity());
  const torch::Tensor parents = draw_rows(weights, n_added, key, n_dead);
  weights = torch::Tensor();
  const torch::Tensor n_children = count_rows(parents, n);

  const torch::Tensor is_copied = (n_replacements.index_select(0, sources) > 0).logical_or_(n_children > 0);
  const torch::Tensor kept = rows_of(is_copied.logical_not());
  const torch::Tensor new_rows = torch::cat({rows_of(is_copied), parents});
  const Copies copies = share(moved, new_rows, n_children, least_logit);
  const torch::Tensor new_sources = sources.index_select(0, new_rows);
  round.edit.sources = torch::cat({kept, new_sources});
  round.edit.n_kept = kept.size(0);
  round.edit.new_means = gaussians.means.index_select(0, new_sources);
  round.edit.new_log_scales = copies.log_scales;
  round.edit.new_logit_opacities = copies.logit_opacities;
  round.n_cloned = n_dead + n_added;
  round.n_pruned = n_dead;
  round.n_over_limit = wanted - n_added;
  return round;
}

void add_mean_noise(GaussianTensors& gaussians, double rate, std::int64_t seed, int iteration,
                    const torch::Tensor& model_rows) {
  MeanNoiseArgs args;
  args.gaussians = arrays_without_colors(gaussians);
  args.means = gaussians.means.data_ptr<float>();
  args.key = {seed, RandomStream::kMeanNoise, static_cast<std::uint32_t>(iteration)};
  args.rate = rate;
  args.log_bound = log_noise_bound(rate);
  if (model_rows.defined()) args.model_rows = model_rows.data_ptr<std::int32_t>();
  for_rows<add_noise_row>(gaussians.means.is_cuda(), args, gaussians.size());
}

}  // namespace b3dgs
