// The outputs of a training, and their times.
#pragma once

#include <algorithm>
#include <vector>

#include "config/train_config.h"

namespace b3dgs {

struct OutputPlan {
  bool log = false;       // a line in train.jsonl
  bool load = false;      // a line there with load statistics
  bool evaluate = false;  // the test views
  bool save = false;      // a PLY
  bool checkpoint = false;
};

/// Returns the outputs of the iterations from `first` to `last`, which are one step.
inline OutputPlan output_plan(const TrainConfig& config, int first, int last, bool has_test_views) {
  constexpr int kLogInterval = 10;
  const auto is_in = [&](const std::vector<int>& list) {
    return std::any_of(list.begin(), list.end(), [&](int own) { return first <= own && own <= last; });
  };
  const auto is_due = [&](int interval) { return interval > 0 && last / interval > (first - 1) / interval; };
  const bool is_last = first <= config.iterations && config.iterations <= last;
  OutputPlan plan;
  plan.evaluate = has_test_views && (is_last || is_in(config.test_iterations));
  plan.log = plan.evaluate || is_last || is_due(kLogInterval);
  // The load is most uneven in the first iteration.
  plan.load = config.stats_interval > 0 && (first == 1 || is_due(config.stats_interval));
  plan.save = is_last || is_in(config.save_iterations);
  plan.checkpoint = is_last || is_in(config.checkpoint_iterations) || is_due(config.checkpoint_interval);
  return plan;
}

}  // namespace b3dgs
