// Times both kernels of a training on the views of its own steps, and lets KernelSelector decide between them. In a
// check, the forward blend of a view is queued with both kernels, between time marks. They share projection and lists,
// and the step continues with the result of the current kernel, so the check affects nothing but time.
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
  /// `machine` is the name of the CPU or GPU, and `clock` the clock of the device.
  KernelCheck(const TrainConfig& config, std::string machine, StageClock clock);
  KernelCheck(const KernelCheck&) = delete;

  /// Returns the current kernel.
  const std::string& kernel() const { return selector_.kernel(); }

  /// Returns the settings for rendering the training view of an iteration, valid until the next call. Views must be
  /// passed in the order of their iterations. A view is passed again if its step failed.
  RenderSettings begin_view(int iteration, RenderSettings settings);

  /// Decides on the kernel if a check is complete, that is, if the view of `next_iteration` does not belong to it.
  /// Waits for the blend of the last view, which a GPU has finished by the time the host begins another step.
  std::optional<KernelDecision> decide(int next_iteration);
  /// Does the same even if the check is incomplete, because training ends.
  std::optional<KernelDecision> finish(int next_iteration);

  /// Returns the state for checkpoints. A check that is interrupted by the end of a session continues with its next
  /// views after a resume.
  nlohmann::ordered_json to_json() const { return selector_.to_json(machine_); }
  /// Restores the state of a checkpoint. @throws InputError naming `place`
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
  std::vector<TimedView> views_;  // views of the current check
  int iteration_ = 0;             // iteration of the last begin_view()
  bool is_warm_ = false;          // both kernels have run in this process
};

/// Returns the fields of the log's "load_statistics" line: distributions over the tiles and pixels of all views
/// together.
nlohmann::ordered_json load_json(const std::vector<ViewLoad>& loads);

}  // namespace b3dgs
