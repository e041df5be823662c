// Measures the candidates for the blending kernels on the training's own data, and lets a KernelSelector choose. What
// is timed is the blend alone: each view is projected and binned once, then blended by every candidate in turn, in
// alternating order. Before times are trusted, every candidate has to agree with the reference kernel on the first
// view, which warms it up too. Parameters, moments, view order and random numbers stay as they are.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "adaptive/kernel_selector.h"
#include "adaptive/kernel_timer.h"
#include "raster/rasterizer.h"
#include "train/train_config.h"

namespace b3dgs {

/// One check of one pass, for log and user.
struct KernelCheck {
  const char* pass = "";  // "forward" or "backward"
  KernelDecision decision;
  std::string message;  // a line for the user if something changed, else empty
};

/// What a check works on.
struct KernelCheckInput {
  Rasterizer& rasterizer;
  const GaussianTensors& gaussians;
  RenderSettings settings;         // of the training's steps, but for the kernels
  std::vector<PinholeView> views;  // that will be trained next
  double step_ms = 0;              // what a step takes, for the limit of a check's cost; 0: not known yet
};

class KernelChecks {
 public:
  /// A check uses no more views than fit into this share of the time between two checks, and stops where there is no
  /// doubt left, but takes at least KernelSelector::kMinViews.
  static constexpr double kCostShare = 0.005;

  /// `timer` is the device's own unless given. The CPU has one backward kernel: nothing is chosen there.
  KernelChecks(const TrainConfig& config, torch::Device device, std::unique_ptr<KernelTimer> timer = nullptr);
  ~KernelChecks();

  /// `settings` with the kernels in use.
  RenderSettings apply(RenderSettings settings) const;

  /// Of the kernels in use; the backward one is empty on the CPU.
  const std::string& forward_name() const { return forward_.kernel(); }
  std::string backward_name() const;

  /// Whether to call check() before this iteration's step.
  bool is_due(int iteration) const { return forward_.is_due(iteration) || backward_.is_due(iteration); }

  /// Measures and decides for each pass that is due. Views that cannot be rendered decide nothing: the step that meets
  /// them says so.
  std::vector<KernelCheck> check(int iteration, const KernelCheckInput& input);

  /// State for a checkpoint, and back; an object without a pass leaves that pass as it is.
  /// @throws InputError naming `place`
  nlohmann::ordered_json to_json() const;
  void restore(const nlohmann::ordered_json& json, const std::string& place);

 private:
  class BlendPass;
  class ForwardBlend;
  class BackwardBlend;
  KernelCheck check_pass(const char* pass, int iteration, KernelSelector& selector, BlendPass& blend,
                         const std::vector<PinholeView>& views, double budget_ms);
  /// Compares what the candidates compute on the prepared view; a fault is why one is not to be used.
  static void find_faults(BlendPass& blend, std::vector<KernelMeasurement>& candidates);
  std::vector<KernelMeasurement> measure(const KernelSelector& selector, BlendPass& blend,
                                         const std::vector<PinholeView>& views, double budget_ms);
  KernelTimer& timer();

  torch::Device device_;
  int interval_;
  std::unique_ptr<KernelTimer> timer_;  // made on first use
  KernelSelector forward_, backward_;
};

/// Fields of the log's "kernel_check" line.
nlohmann::ordered_json to_json(const KernelCheck& check);

/// Fields of the log's "load_statistics" line.
nlohmann::ordered_json load_json(const std::string& view, const ViewLoad& load);

}  // namespace b3dgs
