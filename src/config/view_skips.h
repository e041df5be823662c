// Which steps --skip_share skips, after SkipGS. The loss of each view has a running mean; a view whose last loss was no
// higher than the mean before it can do without its next step. SkipGS renders such a view and skips the backward pass
// and the optimizer step. Here the decision is made before the forward pass, from earlier visits of the view, and the
// whole step is skipped: a GPU need not wait for the loss in the middle of a step, and the forward pass is saved, too.
// A view is skipped at most once in a row, so that its loss never gets older than two epochs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "config/coarse_schedule.h"
#include "config/train_config.h"

namespace b3dgs {

/// Whether losses of this iteration (counted from 1) count, and whether its step may be skipped. Not while
/// --coarse_scale changes the size of the views, on which the loss depends.
inline bool may_skip(const TrainConfig& config, int iteration) {
  return config.skip_share > 0 && iteration > config.skip_from_iter && coarse_scale_at(config, iteration) == 1;
}

/// The losses of one view.
struct ViewLoss {
  static constexpr double kUnseen = -1;

  double mean = kUnseen;  // running mean: 0.95 x old + 0.05 x new
  bool is_low = false;    // the last loss was no higher than the mean before it, and no step was skipped since

  void add(double loss) {
    constexpr double kDecay = 0.95;
    is_low = mean != kUnseen && loss <= mean;
    mean = mean == kUnseen ? loss : kDecay * mean + (1 - kDecay) * loss;
  }
};

/// Part of a checkpoint once a loss has been added.
struct ViewSkips {
  std::int64_t n_skipped = 0;
  std::vector<ViewLoss> views;  // empty before the first loss

  /// Of view `index` of `n_views`.
  ViewLoss& loss_of(std::int32_t index, std::int32_t n_views) {
    if (views.empty()) views.resize(static_cast<std::size_t>(n_views));
    return views[static_cast<std::size_t>(index)];
  }

  /// Whether the step of the view is skipped, which is then recorded: at most `share` of the `n_steps` up to this one,
  /// itself included, are.
  bool skip(std::int32_t index, std::int64_t n_steps, double share) {
    if (views.empty()) return false;
    ViewLoss& view = views[static_cast<std::size_t>(index)];
    if (!view.is_low || static_cast<double>(n_skipped + 1) > share * static_cast<double>(n_steps)) return false;
    view.is_low = false;
    ++n_skipped;
    return true;
  }
};

/// Of `upcoming`, the views of `iteration` and those after it, the ones whose steps will not be skipped, as far as
/// losses are known now. `may_skip_step(i)`: whether the step of iteration i may be.
template <class MaySkipStep>
std::vector<std::int32_t> views_of_steps(ViewSkips skips, const TrainConfig& config, int iteration,
                                         const std::vector<std::int32_t>& upcoming, MaySkipStep&& may_skip_step) {
  std::vector<std::int32_t> views;
  for (const std::int32_t view : upcoming) {
    const bool is_skipped =
        may_skip_step(iteration) && skips.skip(view, iteration - config.skip_from_iter, config.skip_share);
    if (!is_skipped) views.push_back(view);
    ++iteration;
  }
  return views;
}

}  // namespace b3dgs
