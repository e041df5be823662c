#include "train/selection/kernel_chooser.h"

#include <torch/types.h>

#include <algorithm>
#include <chrono>

#include "adaptive/load_statistics.h"
#include "core/check.h"
#include "train/timing/timers.h"

namespace b3dgs {
namespace {

class ForwardBlend final : public BlendPass {
 public:
  explicit ForwardBlend(const BlendInput& input) : input_(input) {}

  void prepare(const CameraView& view) override { input_.render(view, input_.settings); }
  void run(const std::string& kernel) override {
    image_ = input_.rasterizer.reblend(kernel_named(kForwardKernels, kernel));
  }
  void keep() override { kept_ = {image_.color.clone(), {}, image_.alpha.clone()}; }
  std::string fault() const override { return image_fault(image_, kept_); }

 private:
  const BlendInput& input_;
  RenderedView image_, kept_;
};

class BackwardBlend final : public BlendPass {
 public:
  explicit BackwardBlend(const BlendInput& input) : input_(input) {}

  void prepare(const CameraView& view) override {
    const torch::Tensor color = input_.render(view, input_.settings).color;
    // The amount of work does not depend on the gradient's values; this one is nonzero at every pixel.
    grad_.color = torch::full_like(color, 1.0 / static_cast<double>(color.numel()));
  }
  void run(const std::string& kernel) override {
    sums_ = input_.rasterizer.reblend_backward(kernel_named(kBackwardKernels, kernel), grad_);
  }
  void keep() override { kept_ = sums_.clone(); }
  std::string fault() const override { return gradient_fault(sums_, kept_); }

 private:
  const BlendInput& input_;
  RenderedViewGrad grad_;
  torch::Tensor sums_, kept_;
};

}  // namespace

std::unique_ptr<BlendPass> make_forward_blend(const BlendInput& input) {
  return std::make_unique<ForwardBlend>(input);
}

std::unique_ptr<BlendPass> make_backward_blend(const BlendInput& input) {
  return std::make_unique<BackwardBlend>(input);
}

namespace {

constexpr double kRounding = 1e-4, kFlip = 0.02;  // of the image's range
constexpr double kGradientRounding = 1e-3;        // of a column's norm

/// Pixels at which a splat may be on the other side of a threshold: one in ten thousand, and a few in small images.
std::int64_t allowed_flips(std::int64_t n_pixels) {
  return 4 + n_pixels / 10000;
}

}  // namespace

std::string image_fault(const RenderedView& image, const RenderedView& reference) {
  B3DGS_CHECK(image.color.sizes() == reference.color.sizes(), "images of ", image.color.sizes(), " and ",
              reference.color.sizes());
  if (image.alpha.numel() == 0) return "";
  const torch::Tensor difference =
      torch::maximum(torch::amax((image.color - reference.color).abs(), {2}), (image.alpha - reference.alpha).abs());
  const double range = std::max(1.0, reference.color.abs().max().item<double>());
  const auto n_off = torch::logical_not(difference <= kRounding * range).sum().item<std::int64_t>();
  const double largest = difference.max().item<double>(), most = kFlip * range;
  const std::int64_t allowed = allowed_flips(difference.numel());
  if (n_off <= allowed && largest <= most) return "";
  return detail::concat("its image differs in ", n_off, " pixels by up to ", largest, " (at most ", allowed,
                        " pixels and ", most, " can be rounding)");
}

std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference) {
  B3DGS_CHECK(sums.sizes() == reference.sizes(), "gradients of ", sums.sizes(), " and ", reference.sizes());
  const torch::Tensor off = (sums - reference).square().sum(0).sqrt(), norm = reference.square().sum(0).sqrt();
  const torch::Tensor agrees = off <= kGradientRounding * norm + 1e-30;
  if (agrees.all().item<bool>()) return "";
  const double largest = (off / (norm + 1e-30)).max().item<double>();
  return detail::concat("its gradients differ by ", largest, " of their norm (at most ", kGradientRounding,
                        " can be rounding)");
}

namespace {

using Json = nlohmann::ordered_json;

class ClockTimer final : public KernelTimer {
 public:
  explicit ClockTimer(StageClock clock) : clock_(std::move(clock)) {}

  void measure(const std::function<void()>& work) override {
    auto from = clock_();
    work();
    spans_.emplace_back(std::move(from), clock_());
  }
  std::vector<double> finish() override {
    std::vector<double> ms;
    if (!spans_.empty()) spans_.back().second->wait();
    for (const auto& [from, to] : std::exchange(spans_, {})) ms.push_back(to->ms_since(*from));
    return ms;
  }

 private:
  StageClock clock_;
  std::vector<std::pair<std::unique_ptr<StageMark>, std::unique_ptr<StageMark>>> spans_;
};

// The simplest kernels are the reference if candidates disagree.
constexpr const char *kForwardReference = "naive", *kBackwardReference = "per-pixel";

std::vector<std::string> measured_candidates(const TrainConfig& config) {
  // Times differ from run to run, and kernels differ in rounding.
  if (config.deterministic && chooses_forward_kernel(config)) return {kStandardKernel};
  return forward_candidates(config);
}

std::vector<std::string> backward_candidates(const TrainConfig& config, torch::Device device) {
  if (config.backward_kernel != kAdaptive) return {config.backward_kernel};
  if (device.is_cpu() || config.deterministic) return {kStandardBackwardKernel};
  return {kStandardBackwardKernel, kBackwardReference};
}

/// Of the forward or the backward pass.
KernelSelectorOptions selector_options(const TrainConfig& config, torch::Device device, bool is_forward) {
  const std::vector<std::string> forward = measured_candidates(config), backward = backward_candidates(config, device);
  const int n_choices = (forward.size() > 1) + (backward.size() > 1);
  KernelSelectorOptions options;
  options.policy = config.kernel_policy == "tracking" ? KernelPolicy::kTracking : KernelPolicy::kPaper;
  if (is_forward && config.kernel == kPublishedKernel) options.policy = KernelPolicy::kPublished;
  options.interval = config.kernel_check_interval;
  options.cost_share = KernelChooser::kCostShare / std::max(1, n_choices);
  options.reference = is_forward ? kForwardReference : kBackwardReference;
  options.candidates = is_forward ? forward : backward;
  return options;
}

double ms_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

/// Compares the kernels' results on the prepared view and sets the fault of those that disagree.
void find_faults(BlendPass& blend, const std::string& reference, std::vector<KernelMeasurement>& kernels) {
  const auto compare_with = [&](const std::string& kernel) {
    blend.run(kernel);
    blend.keep();
    bool agree = true;
    for (KernelMeasurement& other : kernels) {
      if (other.kernel != kernel) blend.run(other.kernel);
      other.fault = other.kernel != kernel ? blend.fault() : "";
      agree = agree && other.fault.empty();
    }
    return agree;
  };
  // The reference may take longer than all others together, so it runs only if they disagree.
  if (!compare_with(kernels.front().kernel)) compare_with(reference);
}

}  // namespace

std::unique_ptr<KernelTimer> make_kernel_timer(torch::Device device) {
  return std::make_unique<ClockTimer>(make_stage_clock(device));
}

KernelChooser::KernelChooser(const TrainConfig& config, torch::Device device, KernelCheckTools tools)
    : device_(device),
      tools_(std::move(tools)),
      forward_(selector_options(config, device, /*is_forward=*/true)),
      backward_(selector_options(config, device, /*is_forward=*/false)),
      timed_forward_(chooses_forward_kernel(config) ? forward_candidates(config) : config.kernel_candidates) {
  const std::vector<std::string> backward = backward_candidates(config, device);
  if (backward.size() > 1) timed_backward_ = backward;
}

RenderSettings KernelChooser::apply(RenderSettings settings) const {
  settings.kernel = kernel_named(kForwardKernels, forward_.kernel());
  if (!device_.is_cpu()) settings.backward_kernel = kernel_named(kBackwardKernels, backward_.kernel());
  return settings;
}

std::string KernelChooser::backward_name() const {
  return device_.is_cpu() ? "" : backward_.kernel();
}

KernelTimer& KernelChooser::timer() {
  if (tools_.timer == nullptr) tools_.timer = make_kernel_timer(device_);
  return *tools_.timer;
}

std::vector<KernelCheck> KernelChooser::check(const CheckMoment& now, const BlendInput& input) {
  const bool forward_is_due = forward_.is_due(now), backward_is_due = backward_.is_due(now);
  BlendInput own = input;
  own.settings = apply(input.settings);
  std::vector<KernelCheck> checks;
  if (forward_is_due) checks.push_back(check_pass("forward", now, forward_, *tools_.make_forward(own), own));
  if (backward_is_due) checks.push_back(check_pass("backward", now, backward_, *tools_.make_backward(own), own));
  return checks;
}

void KernelChooser::wait_for_device() {
  timer().measure([] {});
  timer().finish();
}

void KernelChooser::try_to_measure(const BlendInput& input, const std::function<void()>& work) {
  try {
    with_remedies(input.remedies, [&] {
      timer().finish();  // what a failed attempt has measured
      work();
    });
  } catch (const NumericError&) {
    timer().finish();
  } catch (const OutOfMemoryError&) {
    timer().finish();
  }
}

double KernelChooser::warm_up(const char* pass, const KernelSelector& selector, BlendPass& blend,
                              const BlendInput& input) {
  if (device_.is_cpu() || !warm_passes_.insert(pass).second) return 0;
  const auto start = std::chrono::steady_clock::now();
  try_to_measure(input, [&] {  // the check that follows meets the same error
    blend.prepare(input.views.front());
    std::vector<KernelMeasurement> kernels;
    for (const std::string& kernel : selector.candidates()) kernels.push_back({kernel, {}, {}});
    find_faults(blend, selector.reference(), kernels);
  });
  wait_for_device();
  return ms_since(start);
}

KernelCheck KernelChooser::check_pass(const char* pass, const CheckMoment& now, KernelSelector& selector,
                                      BlendPass& blend, const BlendInput& input) {
  KernelCheck check;
  check.pass = pass;
  check.warm_up_ms = warm_up(pass, selector, blend, input);
  wait_for_device();  // the steps before are not part of the cost
  const auto start = std::chrono::steady_clock::now();
  const double budget_ms = selector.budget_ms(now.step_ms);
  std::vector<KernelMeasurement> found;
  try_to_measure(input, [&] {
    found = measure(selector.candidates(), selector.reference(), blend, input.views,
                    [&](int n_views, const std::vector<KernelMeasurement>& so_far) {
                      return n_views >= KernelSelector::kMinViews &&
                             (ms_since(start) > budget_ms || selector.is_clear(so_far));
                    });
  });
  check.decision = selector.decide(now, found, ms_since(start));
  check.message = describe_change(check.decision, selector.is_finished());
  return check;
}

std::vector<KernelMeasurement> KernelChooser::measure(const std::vector<std::string>& kernels,
                                                      const std::string& reference, BlendPass& blend,
                                                      const std::vector<CameraView>& views, const IsEnough& is_enough) {
  std::vector<KernelMeasurement> found;
  found.reserve(kernels.size());
  for (const std::string& name : kernels) found.push_back({name, {}, {}});
  std::vector<KernelMeasurement*> order;  // of the kernels that agree with the reference
  for (std::size_t i = 0; i < views.size() && !is_enough(static_cast<int>(i), found); ++i) {
    blend.prepare(views[i]);
    if (i == 0) {
      find_faults(blend, reference, found);
      for (KernelMeasurement& kernel : found) {
        if (kernel.fault.empty()) order.push_back(&kernel);
      }
      if (order.size() < 2) return found;
      blend.run(order.back()->kernel);  // keeps the device busy while the first timed run is queued
    }
    for (const KernelMeasurement* kernel : order) timer().measure([&] { blend.run(kernel->kernel); });
    const std::vector<double> ms = timer().finish();
    for (std::size_t k = 0; k < order.size(); ++k) order[k]->ms.push_back(ms.at(k));
    std::reverse(order.begin(), order.end());
  }
  return found;
}

std::vector<CandidateTiming> KernelChooser::time_candidates(const BlendInput& input) {
  BlendInput own = input;
  own.settings = apply(input.settings);
  std::vector<CandidateTiming> timings;
  const auto time = [&](const char* pass, const std::vector<std::string>& kernels, const std::string& reference,
                        BlendPass& blend) {
    const auto takes_all_views = [](int, const std::vector<KernelMeasurement>&) { return false; };
    try_to_measure(own, [&] {
      timings.push_back({pass, summarize(measure(kernels, reference, blend, own.views, takes_all_views))});
    });
  };
  time("forward", timed_forward_, kForwardReference, *tools_.make_forward(own));
  if (!timed_backward_.empty()) time("backward", timed_backward_, kBackwardReference, *tools_.make_backward(own));
  return timings;
}

nlohmann::ordered_json KernelChooser::to_json() const {
  return {{"forward", forward_.to_json()}, {"backward", backward_.to_json()}};
}

void KernelChooser::restore(const nlohmann::ordered_json& json, const std::string& place) {
  if (json.contains("forward")) forward_.restore(json.at("forward"), place);
  if (json.contains("backward")) backward_.restore(json.at("backward"), place);
}

nlohmann::ordered_json to_json(const KernelCheck& check) {
  Json json = {{"pass", check.pass}};
  json.update(to_json(check.decision));
  if (check.warm_up_ms > 0) json["warm_up_ms"] = check.warm_up_ms;
  return json;
}

nlohmann::ordered_json to_json(const CandidateTiming& timing) {
  Json json = {{"pass", timing.pass}};
  json.update(to_json(timing.times));
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
