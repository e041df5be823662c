// Times the candidate blending kernels on the training's own data, and lets one KernelSelector per pass decide. Only
// blending is timed: each view is projected and binned once, then blended by every candidate in turn, in alternating
// order. Before that, the candidates' results on the first view are compared, which also warms them up. Parameters,
// moments, view order and random numbers do not change.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "adaptive/kernel_selector.h"
#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "train/memory/memory.h"

namespace b3dgs {

// Whether two kernels of one pass computed the same result. They share their arithmetic (raster/math/blend.h), but not
// the order of sums.

/// How `image` disagrees with `reference`, or "". Sums in another order differ by about 1e-5 of the image's range. At a
/// threshold that is enough for a splat to contribute to one image and not to the other, which changes a pixel by up to
/// 1/255 (alpha cutoff) or 0.01 (transmittance stop). So nearly all pixels must agree to 1e-4 of the range (at least
/// 1), and a few to 0.02. Values that are not finite never agree.
std::string image_fault(const RenderedView& image, const RenderedView& reference);

/// How the gradients `sums` [M, K] disagree with `reference`, or "": each of the K columns must agree to 1e-3 of its
/// norm. Single rows are not compared: at low transmittance they are differences of nearly equal sums.
std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference);

// The blending of one view, repeatable with any kernel, to compare and time kernels.

/// The model and the views on which kernels are timed.
struct BlendInput {
  Rasterizer& rasterizer;
  // Renders a view of the model and leaves it in `rasterizer`.
  std::function<RenderedView(const CameraView&, const RenderSettings&)> render;
  RenderSettings settings;               // of training steps
  std::vector<CameraView> views;         // the next views of the training
  std::vector<MemoryRemedy> remedies{};  // with_remedies()
};

/// `run` returns the result, valid until the next run; `fault` how a result disagrees with another, or "".
struct BlendPass {
  using Result = std::vector<torch::Tensor>;

  std::function<void(const CameraView& view)> prepare;  // everything before, and a first blend. @throws NumericError
  std::function<Result(const std::string& kernel)> run;
  std::function<std::string(const Result& result, const Result& kept)> fault;
};

/// `input` must outlive the pass.
BlendPass forward_blend(const BlendInput& input);
BlendPass backward_blend(const BlendInput& input);

/// Makes the runs one after the other, waits for the device, and returns the time that each took there, ms. On a GPU
/// the runs queue up, so that their times do not include launch latency.
using RunTimer = std::function<std::vector<double>(const std::vector<std::function<void()>>& runs)>;
RunTimer make_run_timer(torch::Device device);

class KernelChooser {
 public:
  /// Share of the training time that the checks of both passes may take together.
  static constexpr double kCostShare = 0.005;
  /// Views that a check times, unless fewer are conclusive.
  static constexpr std::size_t kViews = 5;

  using MakeBlend = std::function<BlendPass(const BlendInput&)>;

  /// The CPU has only one backward kernel, so only the forward kernel is selected there. Tests replace how kernels are
  /// timed (empty: the device's own) and run.
  KernelChooser(const TrainConfig& config, torch::Device device, RunTimer time_runs = {},
                MakeBlend make_forward = forward_blend);

  /// `settings` with the kernels in use.
  RenderSettings apply(RenderSettings settings) const;

  /// Names of the kernels in use; the backward name is empty on the CPU.
  const std::string& forward_name() const { return passes_.front().selector.kernel(); }
  std::string backward_name() const;

  /// Whether check() should be called now.
  bool is_due(const CheckMoment& now) const;

  /// Times the candidates and decides, for each pass that is due. Stops early when the selector's budget is used up or
  /// the times are conclusive, but uses at least KernelSelector::kMinViews views. If a view cannot be rendered, or
  /// memory is short after all remedies, nothing is decided: the step that trains on it reports the error.
  std::vector<KernelDecision> check(const CheckMoment& now, const BlendInput& input);

  /// Times the candidates on all views without deciding anything, even if the kernel is fixed: the forward kernels, and
  /// the backward ones if the backward kernel is adaptive. Returns no times if a view cannot be rendered or memory
  /// is short, and none of kernels that disagree with the reference.
  std::vector<KernelTimes> time_candidates(const BlendInput& input) const;

  /// Saves and restores the state, for checkpoints. A pass that is missing in `json` is left unchanged.
  /// @throws InputError naming `place`
  nlohmann::ordered_json to_json() const;
  void restore(const nlohmann::ordered_json& json, const std::string& place);

 private:
  struct Pass {
    const char* name = "";
    KernelSelector selector;
    std::vector<std::string> timed;  // by time_candidates(); empty = the pass is not
    MakeBlend make_blend;
    bool is_warm = false;
  };
  /// Whether the times on so many views are enough.
  using IsEnough = std::function<bool(std::size_t n_views, const std::vector<KernelMeasurement>&)>;

  /// Runs and compares the candidates once before the first check of a pass: on a GPU a kernel's first launch loads its
  /// code, and the first view allocates memory. That happens once per process; counted as the cost of a check it would
  /// delay the next one. Returns the time taken, ms, including work queued before.
  double warm_up(Pass& pass, const BlendPass& blend, const BlendInput& input) const;
  KernelDecision check_pass(Pass& pass, const CheckMoment& now, const BlendInput& input) const;
  /// Times kernels on the views. A kernel that disagrees with `reference` gets a fault and no times.
  std::vector<KernelMeasurement> measure(const std::vector<std::string>& kernels, const std::string& reference,
                                         const BlendPass& blend, const std::vector<CameraView>& views,
                                         const IsEnough& is_enough) const;

  torch::Device device_;
  RunTimer time_runs_;
  std::vector<Pass> passes_;  // forward, backward
};

/// Fields of the log's "load_statistics" line.
nlohmann::ordered_json load_json(const std::string& view, const ViewLoad& load);

}  // namespace b3dgs
