// What a training writes, and when.
#pragma once

#include <algorithm>

#include "config/train_config.h"

namespace b3dgs {

struct OutputPlan {
  bool log = false;           // a line in train.jsonl
  bool statistics = false;    // a line there with load statistics
  bool kernel_times = false;  // lines there with times of the candidate kernels
  bool evaluate = false;      // the test views
  bool save = false;          // a PLY
  bool checkpoint = false;
};

inline OutputPlan output_plan(const TrainConfig& config, int iteration, bool has_test_views) {
  constexpr int kLogInterval = 10;
  const auto is_in = [&](const std::vector<int>& list) {
    return std::find(list.begin(), list.end(), iteration) != list.end();
  };
  const bool is_last = iteration == config.iterations;
  OutputPlan plan;
  plan.evaluate = has_test_views && (is_last || is_in(config.test_iterations));
  plan.log = plan.evaluate || is_last || iteration % kLogInterval == 0;
  // The load is most uneven in the first iteration.
  plan.statistics = config.stats_interval > 0 && (iteration == 1 || iteration % config.stats_interval == 0);
  plan.kernel_times = config.kernel_times_interval > 0 && (is_last || iteration % config.kernel_times_interval == 0);
  plan.save = is_last || is_in(config.save_iterations);
  plan.checkpoint = is_last || is_in(config.checkpoint_iterations) ||
                    (config.checkpoint_interval > 0 && iteration % config.checkpoint_interval == 0);
  return plan;
}

/// What falls on any of the iterations from `first` to `last`, which are one step.
inline OutputPlan output_plan(const TrainConfig& config, int first, int last, bool has_test_views) {
  OutputPlan plan = output_plan(config, last, has_test_views);
  for (int iteration = first; iteration < last; ++iteration) {
    const OutputPlan other = output_plan(config, iteration, has_test_views);
    plan.log |= other.log;
    plan.statistics |= other.statistics;
    plan.kernel_times |= other.kernel_times;
    plan.evaluate |= other.evaluate;
    plan.save |= other.save;
    plan.checkpoint |= other.checkpoint;
  }
  return plan;
}

}  // namespace b3dgs
