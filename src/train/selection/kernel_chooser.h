// Measures the candidates for the blending kernels on the training's own data, and lets a KernelSelector for each pass
// choose. What is timed is the blend alone: each view is projected and binned once, then blended by every candidate in
// turn, in alternating order. Before times are trusted, every candidate has to agree with the reference kernel on the
// first view, which warms it up too. Parameters, moments, view order and random numbers stay as they are.
#pragma once

#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "adaptive/kernel_selector.h"
#include "adaptive/kernel_timer.h"
#include "train/config/train_config.h"
#include "train/selection/blend_pass.h"

namespace b3dgs {

/// One check of one pass, for log and user.
struct KernelCheck {
  const char* pass = "";  // "forward" or "backward"
  KernelDecision decision;
  double warm_up_ms = 0;  // before the first check of a pass: not part of its cost
  std::string message;    // a line for the user if something changed, else empty
};

/// Times of the candidates for one pass that nothing is decided by.
struct CandidateTiming {
  const char* pass = "";  // "forward" or "backward"
  KernelTimes times;
};

/// What measures and what is measured; tests put their own in place of the device's.
struct KernelCheckTools {
  using MakeBlend = std::function<std::unique_ptr<BlendPass>(const BlendInput&)>;

  std::unique_ptr<KernelTimer> timer;  // the device's own if null
  MakeBlend make_forward = make_forward_blend, make_backward = make_backward_blend;
};

class KernelChooser {
 public:
  /// Share of the training time that checks of both passes together may take.
  static constexpr double kCostShare = 0.005;

  /// The CPU has one backward kernel: nothing is chosen there.
  KernelChooser(const TrainConfig& config, torch::Device device, KernelCheckTools tools = {});

  /// `settings` with the kernels in use.
  RenderSettings apply(RenderSettings settings) const;

  /// Of the kernels in use; the backward one is empty on the CPU.
  const std::string& forward_name() const { return forward_.kernel(); }
  std::string backward_name() const;

  /// Whether to call check() now.
  bool is_due(const CheckMoment& now) const { return forward_.is_due(now) || backward_.is_due(now); }

  /// Measures and decides for each pass that is due. No more views are used than the selector's budget allows or than
  /// leave no doubt, but KernelSelector::kMinViews at least. Views that cannot be rendered decide nothing: the step
  /// that meets them says so.
  std::vector<KernelCheck> check(const CheckMoment& now, const BlendInput& input);

  /// Times the candidates on all views, also where the kernel is fixed or chosen for good, and decides nothing: the
  /// forward ones, and the backward ones if the backward kernel is adaptive. Nothing comes of views that cannot be
  /// rendered, and no times of kernels that do not agree with the reference.
  std::vector<CandidateTiming> time_candidates(const BlendInput& input);

  /// State for a checkpoint, and back; an object without a pass leaves that pass as it is.
  /// @throws InputError naming `place`
  nlohmann::ordered_json to_json() const;
  void restore(const nlohmann::ordered_json& json, const std::string& place);

 private:
  /// Whether what so many views gave is enough.
  using IsEnough = std::function<bool(int n_views, const std::vector<KernelMeasurement>&)>;

  /// Runs and compares the candidates once before a pass is checked for the first time: on a GPU a kernel's first
  /// launch loads its code, and the first view makes room for the others. That is paid once in a process; as the price
  /// of a check it would put the next one off. Returns the time it took, ms, with all work that was queued before.
  double warm_up(const char* pass, const KernelSelector& selector, BlendPass& blend, const PinholeView& view);
  void wait_for_device();
  KernelCheck check_pass(const char* pass, const CheckMoment& now, KernelSelector& selector, BlendPass& blend,
                         const BlendInput& input);
  /// Times kernels on the views. A kernel that does not agree with `reference` has a fault and no times.
  std::vector<KernelMeasurement> measure(const std::vector<std::string>& kernels, const std::string& reference,
                                         BlendPass& blend, const std::vector<PinholeView>& views,
                                         const IsEnough& is_enough);
  KernelTimer& timer();

  torch::Device device_;
  KernelCheckTools tools_;  // the timer is made on first use
  KernelSelector forward_, backward_;
  std::set<std::string> warm_passes_;
  std::vector<std::string> timed_forward_, timed_backward_;  // by time_candidates(); empty: not timed
};

/// Fields of the log's "kernel_check" line.
nlohmann::ordered_json to_json(const KernelCheck& check);

/// Fields of the log's "kernel_times" line.
nlohmann::ordered_json to_json(const CandidateTiming& timing);

/// Fields of the log's "load_statistics" line.
nlohmann::ordered_json load_json(const std::string& view, const ViewLoad& load);

}  // namespace b3dgs
