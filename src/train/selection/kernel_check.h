// Times both kernels of a training on the views of its own steps, and lets KernelSelector decide. In a check, the
// forward blend of a view is queued by both kernels, between marks. Projection and lists are shared, and the step goes
// on with the result of the kernel in use, so nothing but time depends on it.
#pragma once

#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "adaptive/kernel_selector.h"
#include "config/train_config.h"
#include "raster/args.h"
#include "raster/torch/rasterizer.h"
#include "train/timing/timers.h"

namespace b3dgs {

class KernelCheck {
 public:
  /// `machine`: name of the CPU or GPU. `clock`: of the device.
  KernelCheck(const TrainConfig& config, std::string machine, StageClock clock);
  KernelCheck(const KernelCheck&) = delete;

  /// The kernel in use.
  const std::string& kernel() const { return selector_.kernel(); }

  /// Settings for rendering the training view of an iteration, valid until the next call. Views come in their order;
  /// a view that failed comes again.
  RenderSettings begin_view(int iteration, RenderSettings settings);

  /// Decides if a check is complete, that is, if the view of `next_iteration` does not belong to it. Waits for the
  /// blend of the last view, which a GPU has done by the time the host begins another step.
  std::optional<KernelDecision> decide(int next_iteration);
  /// The same also if more views belong to it: training ends.
  std::optional<KernelDecision> finish(int next_iteration);

  /// The state, for checkpoints. A check that is under way continues with the views after a resume.
  nlohmann::ordered_json to_json() const { return selector_.to_json(machine_); }
  /// @throws InputError naming `place`
  void restore(const nlohmann::ordered_json& json, const std::string& place) {
    selector_.restore(json, machine_, place);
  }

 private:
  struct TimedView {
    int iteration = 0;
    bool other_first = false;
    std::unique_ptr<StageMark> marks[3];
  };
  void time_blends(const std::function<void(ForwardKernel)>& blend);

  KernelSelector selector_;
  const std::string machine_;
  const StageClock clock_;
  const BlendRunner run_blend_ = [this](const auto& blend) { time_blends(blend); };
  std::vector<TimedView> views_;  // of the check under way
  int iteration_ = 0;             // of the view that was begun
  bool is_warm_ = false;          // both kernels have run in this process
};

/// Fields of the log's "load_statistics" line: distributions over the tiles and pixels of all views together.
nlohmann::ordered_json load_json(const std::vector<ViewLoad>& loads);

}  // namespace b3dgs
