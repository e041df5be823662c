#include "train/selection/kernel_check.h"

#include <torch/types.h>

#include <utility>

#include "adaptive/load_statistics.h"

namespace b3dgs {
namespace {

KernelRule rule_of(const TrainConfig& config) {
  KernelRule rule;
  rule.interval = config.kernel_check_interval;
  const auto use = [&](ForwardKernel first, ForwardKernel second, KernelPolicy policy) {
    rule.first = kernel_name(first), rule.second = kernel_name(second), rule.policy = policy;
  };
  if (config.kernel == kPublishedKernel) {
    use(ForwardKernel::kCombined, ForwardKernel::kSharedMemory, KernelPolicy::kPublished);
  } else if (config.kernel != kAdaptive) {
    rule.first = config.kernel;
  } else if (config.deterministic) {  // no timing, because times differ from run to run and kernels differ in rounding
    use(kStandardKernel, ForwardKernel::kSegmented, KernelPolicy::kFixed);
  } else {
    use(ForwardKernel::kSegmented, kStandardKernel, KernelPolicy::kAdaptive);
  }
  return rule;
}

}  // namespace

KernelCheck::KernelCheck(const TrainConfig& config, std::string machine, StageClock clock)
    : selector_(rule_of(config)), machine_(std::move(machine)), clock_(std::move(clock)) {}

RenderSettings KernelCheck::begin_view(int iteration, RenderSettings settings) {
  iteration_ = iteration;
  settings.kernel = kernel_named(selector_.kernel());
  settings.run_blend = selector_.check_of(iteration) >= 0 ? &run_blend_ : nullptr;
  return settings;
}

void KernelCheck::time_blends(const std::function<void(ForwardKernel)>& blend) {
  const ForwardKernel in_use = kernel_named(selector_.kernel()), other = kernel_named(selector_.other());
  if (!views_.empty() && views_.back().iteration == iteration_) views_.pop_back();  // the step failed and is repeated
  TimedView view;
  view.iteration = iteration_;
  view.other_first = views_.size() % 2 == 0;
  view.marks[0] = clock_();
  blend(view.other_first ? other : in_use);
  view.marks[1] = clock_();
  blend(view.other_first ? in_use : other);
  view.marks[2] = clock_();
  if (!view.other_first) blend(in_use);  // the step continues with this result
  // The first launch of a kernel loads its code, so it is not counted.
  if (std::exchange(is_warm_, true)) views_.push_back(std::move(view));
}

std::optional<KernelDecision> KernelCheck::decide(int next_iteration) {
  const bool is_under_way =
      !views_.empty() && selector_.check_of(next_iteration) == selector_.check_of(views_.front().iteration);
  return is_under_way ? std::nullopt : finish(next_iteration);
}

std::optional<KernelDecision> KernelCheck::finish(int next_iteration) {
  if (views_.empty()) return std::nullopt;
  views_.back().marks[2]->wait();
  std::vector<ViewTimes> times;
  double cost_ms = 0;
  for (const TimedView& view : views_) {
    const double first_ms = view.marks[1]->ms_since(*view.marks[0]),
                 second_ms = view.marks[2]->ms_since(*view.marks[1]);
    times.push_back(view.other_first ? ViewTimes{second_ms, first_ms} : ViewTimes{first_ms, second_ms});
    cost_ms += view.other_first ? first_ms : first_ms + second_ms;
  }
  views_.clear();
  KernelDecision decision = selector_.decide(next_iteration, std::move(times));
  decision.cost_ms = cost_ms;
  return decision;
}

nlohmann::ordered_json load_json(const std::vector<ViewLoad>& loads) {
  const auto distribution = [&](torch::Tensor ViewLoad::*member) {
    std::vector<torch::Tensor> parts;
    for (const ViewLoad& load : loads) parts.push_back((load.*member).flatten().to(torch::kInt64));
    const torch::Tensor all = torch::cat(parts);
    return to_json(load_statistics(all.data_ptr<std::int64_t>(), all.numel()));
  };
  return {{"views", loads.size()},
          {"tile_lists", distribution(&ViewLoad::tile_lists)},
          {"pixel_processed", distribution(&ViewLoad::processed)},
          {"pixel_contributing", distribution(&ViewLoad::contributing)}};
}

}  // namespace b3dgs
