#include "train/kernel_check.h"

#include <torch/torch.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <optional>

#include "adaptive/load_statistics.h"
#include "check.h"
#include "train/kernel_agreement.h"

#if B3DGS_TORCH_CUDA
#include "adaptive/cuda/cuda_event_timer.h"
#include "raster/torch_launch.h"
#endif

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// The plainest schedules judge the others.
constexpr const char *kForwardReference = "naive", *kBackwardReference = "per-pixel";

ForwardKernel forward_kernel(const std::string& name) {
  const std::optional<ForwardKernel> kernel = find_forward_kernel(name);
  B3DGS_CHECK(kernel.has_value(), "no kernel has the name ", name);
  return *kernel;
}

BackwardKernel backward_kernel(const std::string& name) {
  const std::optional<BackwardKernel> kernel = find_backward_kernel(name);
  B3DGS_CHECK(kernel.has_value(), "no backward kernel has the name ", name);
  return *kernel;
}

KernelSelectorOptions selector_options(const TrainConfig& config) {
  KernelSelectorOptions options;
  options.policy = config.kernel_policy == "tracking" ? KernelPolicy::kTracking : KernelPolicy::kPaper;
  options.interval = config.kernel_check_interval;
  return options;
}

KernelSelectorOptions forward_options(const TrainConfig& config) {
  KernelSelectorOptions options = selector_options(config);
  options.reference = kForwardReference;
  options.candidates = {config.kernel};
  if (config.kernel == kAdaptive) {
    // A choice by times would differ from run to run, and kernels differ in the last digits.
    options.candidates = config.deterministic ? std::vector<std::string>{kUnmeasuredKernel} : config.kernel_candidates;
  }
  return options;
}

KernelSelectorOptions backward_options(const TrainConfig& config, torch::Device device) {
  KernelSelectorOptions options = selector_options(config);
  options.reference = kBackwardReference;
  options.candidates = {config.backward_kernel};
  if (config.backward_kernel == kAdaptive) options.candidates = {kUnmeasuredBackwardKernel, kBackwardReference};
  if (device.is_cpu() || config.deterministic) options.candidates.resize(1);
  return options;
}

double ms_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

/// A blend that can be run on one view with any of its kernels.
class KernelChecks::BlendPass {
 public:
  virtual ~BlendPass() = default;
  /// Everything before the blend, and a first blend. @throws NumericError
  virtual void prepare(const PinholeView& view) = 0;
  virtual void run(const std::string& kernel) = 0;
  /// Keeps what the last run() computed.
  virtual void keep() = 0;
  /// Of the last run() against that.
  virtual std::string fault() const = 0;
  /// Name of the kernel that is right if others disagree.
  virtual std::string reference() const = 0;
};

class KernelChecks::ForwardBlend final : public BlendPass {
 public:
  ForwardBlend(const KernelCheckInput& input, const RenderSettings& settings) : input_(input), settings_(settings) {}

  void prepare(const PinholeView& view) override { input_.rasterizer.forward(input_.gaussians, view, settings_); }
  void run(const std::string& kernel) override { image_ = input_.rasterizer.reblend(forward_kernel(kernel)); }
  void keep() override { kept_ = {image_.color.clone(), {}, image_.alpha.clone()}; }
  std::string fault() const override { return image_fault(image_, kept_); }
  std::string reference() const override { return kForwardReference; }

 private:
  const KernelCheckInput& input_;
  RenderSettings settings_;
  RenderedView image_, kept_;
};

class KernelChecks::BackwardBlend final : public BlendPass {
 public:
  BackwardBlend(const KernelCheckInput& input, const RenderSettings& settings) : input_(input), settings_(settings) {}

  void prepare(const PinholeView& view) override {
    const torch::Tensor color = input_.rasterizer.forward(input_.gaussians, view, settings_).color;
    // Which gradient it is makes no difference to the work; this one reaches every pixel.
    grad_.color = torch::full_like(color, 1.0 / static_cast<double>(color.numel()));
  }
  void run(const std::string& kernel) override {
    sums_ = input_.rasterizer.reblend_backward(backward_kernel(kernel), grad_);
  }
  void keep() override { kept_ = sums_.clone(); }
  std::string fault() const override { return gradient_fault(sums_, kept_); }
  std::string reference() const override { return kBackwardReference; }

 private:
  const KernelCheckInput& input_;
  RenderSettings settings_;
  RenderedViewGrad grad_;
  torch::Tensor sums_, kept_;
};

KernelChecks::KernelChecks(const TrainConfig& config, torch::Device device, std::unique_ptr<KernelTimer> timer)
    : device_(device),
      interval_(config.kernel_check_interval),
      timer_(std::move(timer)),
      forward_(forward_options(config)),
      backward_(backward_options(config, device)) {}
KernelChecks::~KernelChecks() = default;

RenderSettings KernelChecks::apply(RenderSettings settings) const {
  settings.kernel = forward_kernel(forward_.kernel());
  if (!device_.is_cpu()) settings.backward_kernel = backward_kernel(backward_.kernel());
  return settings;
}

std::string KernelChecks::backward_name() const {
  return device_.is_cpu() ? "" : backward_.kernel();
}

KernelTimer& KernelChecks::timer() {
  if (timer_ != nullptr) return *timer_;
  if (device_.is_cpu()) {
    timer_ = std::make_unique<SteadyTimer>();
  } else {
#if B3DGS_TORCH_CUDA
    timer_ = std::make_unique<CudaEventTimer>(torch_launch_context().stream);
#endif
  }
  B3DGS_CHECK(timer_ != nullptr, "this build has no timer for ", device_.str());
  return *timer_;
}

std::vector<KernelCheck> KernelChecks::check(int iteration, const KernelCheckInput& input) {
  const bool forward_is_due = forward_.is_due(iteration), backward_is_due = backward_.is_due(iteration);
  const RenderSettings settings = apply(input.settings);
  double budget_ms = std::numeric_limits<double>::infinity();
  if (input.step_ms > 0) budget_ms = kCostShare * interval_ * input.step_ms / (forward_is_due + backward_is_due);
  std::vector<KernelCheck> checks;
  if (forward_is_due) {
    ForwardBlend blend(input, settings);
    checks.push_back(check_pass("forward", iteration, forward_, blend, input.views, budget_ms));
  }
  if (backward_is_due) {
    BackwardBlend blend(input, settings);
    checks.push_back(check_pass("backward", iteration, backward_, blend, input.views, budget_ms));
  }
  return checks;
}

KernelCheck KernelChecks::check_pass(const char* pass, int iteration, KernelSelector& selector, BlendPass& blend,
                                     const std::vector<PinholeView>& views, double budget_ms) {
  timer().measure([] {});
  timer().finish();  // the steps before are done, and not part of the cost
  const auto start = std::chrono::steady_clock::now();
  std::vector<KernelMeasurement> found;
  try {
    found = measure(selector, blend, views, budget_ms);
  } catch (const NumericError&) {
    timer().finish();
  }
  KernelCheck check;
  check.pass = pass;
  check.decision = selector.decide(iteration, found, ms_since(start));
  check.message = describe_change(check.decision, selector.is_finished());
  return check;
}

void KernelChecks::find_faults(BlendPass& blend, std::vector<KernelMeasurement>& candidates) {
  const auto compare_with = [&](const std::string& kernel) {
    blend.run(kernel);
    blend.keep();
    bool agree = true;
    for (KernelMeasurement& candidate : candidates) {
      if (candidate.kernel != kernel) blend.run(candidate.kernel);
      candidate.fault = candidate.kernel != kernel ? blend.fault() : "";
      agree = agree && candidate.fault.empty();
    }
    return agree;
  };
  // The reference may take longer than all candidates together. It is asked only if they do not agree.
  if (!compare_with(candidates.front().kernel)) compare_with(blend.reference());
}

std::vector<KernelMeasurement> KernelChecks::measure(const KernelSelector& selector, BlendPass& blend,
                                                     const std::vector<PinholeView>& views, double budget_ms) {
  const auto start = std::chrono::steady_clock::now();
  std::vector<KernelMeasurement> found;
  for (const std::string& name : selector.candidates()) found.push_back({name, {}, {}});
  std::vector<KernelMeasurement*> order;  // of those that agree with the reference
  for (std::size_t i = 0; i < views.size(); ++i) {
    const bool has_enough = i >= static_cast<std::size_t>(KernelSelector::kMinViews);
    if (has_enough && (ms_since(start) > budget_ms || selector.is_clear(found))) break;
    blend.prepare(views[i]);
    if (i == 0) {
      find_faults(blend, found);
      for (KernelMeasurement& candidate : found) {
        if (candidate.fault.empty()) order.push_back(&candidate);
      }
      if (order.size() < 2) return found;
      blend.run(order.back()->kernel);  // keeps the device busy while the first timed one is queued
    }
    for (const KernelMeasurement* candidate : order) timer().measure([&] { blend.run(candidate->kernel); });
    const std::vector<double> ms = timer().finish();
    for (std::size_t c = 0; c < order.size(); ++c) order[c]->ms.push_back(ms.at(c));
    std::reverse(order.begin(), order.end());
  }
  return found;
}

nlohmann::ordered_json KernelChecks::to_json() const {
  return {{"forward", forward_.to_json()}, {"backward", backward_.to_json()}};
}

void KernelChecks::restore(const nlohmann::ordered_json& json, const std::string& place) {
  try {
    if (json.contains("forward")) forward_.restore(json.at("forward"));
    if (json.contains("backward")) backward_.restore(json.at("backward"));
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": the record of kernel checks is not what this program writes: ", error.what());
  }
}

nlohmann::ordered_json to_json(const KernelCheck& check) {
  Json json = {{"pass", check.pass}};
  json.update(to_json(check.decision));
  return json;
}

nlohmann::ordered_json load_json(const std::string& view, const ViewLoad& load) {
  const auto pixels = [](const torch::Tensor& counts) {
    return to_json(load_statistics(counts.data_ptr<std::int32_t>(), counts.numel()));
  };
  return {{"view", view},
          {"tile_lists", to_json(load_statistics(load.tile_lists.data_ptr<std::int64_t>(), load.tile_lists.numel()))},
          {"pixel_processed", pixels(load.processed)},
          {"pixel_contributing", pixels(load.contributing)}};
}

}  // namespace b3dgs
