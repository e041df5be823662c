#include "train/density/strategies/strategies.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "raster/math/opacity.h"
#include "raster/torch/torch_cuda.h"
#include "train/density/strategies/budget_kernels.h"

namespace b3dgs {
namespace {

/// Number of scored views in which a Gaussian must be visible before it can be pruned for its blend weight, because it
/// may be occluded in many of them. A Gaussian that is unoccluded in 30 % of the views is occluded in all of 20 random
/// views with probability 0.0008.
constexpr int kPruneViews = 20;

/// Fraction of the parents of a round that are drawn outside of --crop.
constexpr double kOutsideShare = 0.1;

constexpr const char* kColumnNames[] = {"error_sum", "max_weight", "score_views"};

template <class Statistics>
auto& column(Statistics& statistics, BudgetColumn which) {
  return statistics.extra.at(static_cast<std::size_t>(which)).values;
}

/// Returns a random key for each of `rows`. The rows with the largest keys are the sample.
torch::Tensor draw_keys(const torch::Tensor& rows, const torch::Tensor& scores, const RandomKey& key) {
  torch::Tensor keys = torch::empty({rows.size(0)}, scores.options());
  const ParentKeyArgs args{rows.data_ptr<std::int64_t>(), scores.data_ptr<float>(), key, keys.data_ptr<float>()};
  for_rows<draw_parent_key>(keys.is_cuda(), args, rows.size(0));
  return keys;
}

/// Sets the edit's new rows to the parts of `parents`.
void add_parts(const GaussianTensors& gaussians, const torch::Tensor& parents, RowEdit& edit) {
  const std::int64_t n = parents.size(0);
  edit.new_means = torch::empty({2 * n, 3}, gaussians.means.options());
  edit.new_log_scales = torch::empty({2 * n, 3}, gaussians.means.options());
  edit.new_logit_opacities = torch::empty({2 * n}, gaussians.means.options());
  PartArgs args;
  args.n_parents = n;
  args.parents = parents.data_ptr<std::int64_t>();
  args.gaussians = arrays_without_colors(gaussians);
  args.out_means = edit.new_means.data_ptr<float>();
  args.out_log_scales = edit.new_log_scales.data_ptr<float>();
  args.out_logit_opacities = edit.new_logit_opacities.data_ptr<float>();
  for_rows<make_part>(parents.is_cuda(), args, 2 * n);
}

/// Returns whether each of `means` [n, 3] is in the region, [n] bool.
torch::Tensor inside(const CropRegion& region, const torch::Tensor& means) {
  const auto vector = [&](const std::array<double, 3>& v) {
    return torch::tensor({v[0], v[1], v[2]}, means.options());
  };
  if (region.radius > 0) return (means - vector(region.center)).norm(2, 1) <= region.radius;
  return (means >= vector(region.low)).logical_and_(means <= vector(region.high)).all(1);
}

int last_growth_round(const TrainConfig& config) {
  return (config.densify_until_iter - 1) / config.densification_interval * config.densification_interval;
}

/// Returns sqrt(t) of budget_growth().
double budget_progress(const TrainConfig& config, int iteration) {
  const int first = config.densify_from_iter, last = last_growth_round(config);
  if (iteration >= last) return 1;
  if (iteration <= first) return 0;
  return std::sqrt(static_cast<double>(iteration - first) / (last - first));
}

/// Returns the iteration rounded up to a multiple of `interval`.
int next_multiple(int iteration, int interval) {
  return (iteration + interval - 1) / interval * interval;
}

/// Returns whether Gaussians are pruned for their blend weight in this iteration.
bool is_weight_prune_round(const TrainConfig& config, int iteration) {
  const std::int64_t until = std::int64_t{config.position_lr_max_steps} * 14 / 15;  // 28,000 of 30,000
  return config.prune_weight > 0 && iteration > config.densify_from_iter && iteration < until &&
         iteration % config.opacity_reset_interval == 0;
}

class BudgetStrategy final : public DensityStrategy {
 public:
  using DensityStrategy::DensityStrategy;

  DensityStatistics make_statistics(std::int64_t n_gaussians, torch::Device device) const override {
    DensityStatistics statistics = make_density_statistics(n_gaussians, device);
    for (const char* name : kColumnNames) {
      statistics.extra.push_back({name, torch::zeros_like(statistics.grad_norm_sum)});
    }
    return statistics;
  }

  DensityPlan plan(int iteration) const override {
    DensityPlan plan;
    plan.densify = is_growth_round(config_, iteration) || is_weight_prune_round(config_, iteration);
    // This includes rounds beyond --iterations, because the training may be resumed with more iterations.
    const int window_end = next_multiple(iteration, config_.densification_interval);
    plan.score = window_end - iteration < config_.score_views && window_end > config_.densify_from_iter &&
                 (is_growth_round(config_, window_end) ||
                  is_weight_prune_round(config_, next_multiple(iteration, config_.opacity_reset_interval)));
    plan.statistics = plan.score;
    return plan;
  }

  void after_view(const DensityView& seen, DensityStatistics& statistics) const override {
    if (!plan(seen.iteration).score) return;
    seen.add_scores({column(statistics, BudgetColumn::kErrorSum), column(statistics, BudgetColumn::kMaxWeight),
                     column(statistics, BudgetColumn::kScoreViews), torch::Tensor()});
  }

  DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics& statistics, int iteration,
                          std::int64_t max_gaussians) const override {
    DensityRound round;
    torch::Tensor stays = gaussians.logit_opacities >= logit(config_.prune_opacity);
    if (is_weight_prune_round(config_, iteration)) {
      const torch::Tensor has_views = column(statistics, BudgetColumn::kScoreViews) >= kPruneViews;
      const torch::Tensor is_faint = column(statistics, BudgetColumn::kMaxWeight) < config_.prune_weight;
      stays.logical_and_(has_views.logical_and_(is_faint).logical_not_());
    }
    const std::int64_t n = gaussians.size(), n_stay = stays.sum().item<std::int64_t>();
    torch::Tensor parents = torch::empty({0}, stays.options().dtype(torch::kInt64));
    if (is_growth_round(config_, iteration)) {
      parents = choose_parents(gaussians, statistics, stays, iteration, n_stay, max_gaussians, round.n_over_limit);
    }
    stays.index_fill_(0, parents, 0);
    const torch::Tensor kept = rows_of(stays);
    round.edit.sources = torch::cat({kept, parents, parents});
    round.edit.n_kept = kept.size(0);
    add_parts(gaussians, parents, round.edit);
    round.n_split = parents.size(0);
    round.n_pruned = n - n_stay;
    return round;
  }

  /// Resets the statistics that the round used: errors after a growth round, weights after a round that prunes by
  /// weight. The two kinds of round may fall on different iterations, and a round that only prunes must not leave the
  /// next growth round with the errors of a few views.
  void end_round(int iteration, DensityStatistics& statistics) const override {
    const bool keeps_weights = config_.prune_weight > 0 && !is_weight_prune_round(config_, iteration);
    const bool keeps_errors = !is_growth_round(config_, iteration);
    for (torch::Tensor* own : statistics.all()) {
      const bool is_weight =
          own == &column(statistics, BudgetColumn::kMaxWeight) || own == &column(statistics, BudgetColumn::kScoreViews);
      if (!(is_weight ? keeps_weights : keeps_errors)) own->zero_();
    }
  }

 private:
  /// Returns the indices of the Gaussians to split, ascending. Their number is limited by the budget and by
  /// `max_gaussians` (0 = no limit), given that `n_stay` Gaussians are not pruned. `n_over_limit` receives the number
  /// that `max_gaussians` excluded. With --crop, at most kOutsideShare of them are outside. If there are too few
  /// candidates inside, there are fewer parents.
  torch::Tensor choose_parents(const GaussianTensors& gaussians, const DensityStatistics& statistics,
                               const torch::Tensor& stays, int iteration, std::int64_t n_stay,
                               std::int64_t max_gaussians, std::int64_t& n_over_limit) const {
    const torch::Tensor& scores = column(statistics, BudgetColumn::kErrorSum);
    const torch::Tensor rows = rows_of((scores > 0).logical_and_(stays));
    std::int64_t n_wanted = rows.size(0);
    if (config_.max_gaussians > 0) {
      n_wanted = std::min(n_wanted, budget_growth(config_, iteration, n_stay, config_.max_gaussians));
    }
    std::int64_t n_parents = n_wanted;
    if (max_gaussians > 0) n_parents = std::clamp<std::int64_t>(max_gaussians - n_stay, 0, n_wanted);
    n_over_limit = n_wanted - n_parents;
    const torch::Tensor keys =
        draw_keys(rows, scores, {config_.seed, RandomStream::kParents, static_cast<std::uint32_t>(iteration)});
    if (!region_) return std::get<0>(largest_rows(rows, keys, n_parents).sort());
    const torch::Tensor is_inside = inside(*region_, gaussians.means.index_select(0, rows));
    const auto draw = [&](const torch::Tensor& places, std::int64_t n) {
      return largest_rows(rows.index_select(0, places), keys.index_select(0, places), std::min(n, places.size(0)));
    };
    const auto n_outside = static_cast<std::int64_t>(kOutsideShare * static_cast<double>(n_parents));
    const torch::Tensor within = draw(rows_of(is_inside), n_parents - n_outside),
                        beyond = draw(rows_of(is_inside.logical_not()), n_outside);
    return std::get<0>(torch::cat({within, beyond}).sort());
  }
};

}  // namespace

std::unique_ptr<DensityStrategy> make_budget_strategy(const TrainConfig& config, double extent) {
  return std::make_unique<BudgetStrategy>(config, extent);
}

std::int64_t budget_growth(const TrainConfig& config, int iteration, std::int64_t n, std::int64_t budget) {
  if (n >= budget) return 0;
  const double before = budget_progress(config, iteration - config.densification_interval);
  const double share = before < 1 ? (budget_progress(config, iteration) - before) / (1 - before) : 1;
  return std::llround(share * static_cast<double>(budget - n));
}

}  // namespace b3dgs
