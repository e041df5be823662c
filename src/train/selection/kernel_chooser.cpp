#include "train/selection/kernel_chooser.h"

#include <torch/types.h>

#include <algorithm>
#include <chrono>

#include "adaptive/load_statistics.h"
#include "core/check.h"
#include "train/timing/timers.h"

namespace b3dgs {

using Result = BlendPass::Result;

std::string image_fault(const RenderedView& image, const RenderedView& reference) {
  B3DGS_CHECK(image.color.sizes() == reference.color.sizes(), "images of ", image.color.sizes(), " and ",
              reference.color.sizes());
  if (image.alpha.numel() == 0) return "";
  constexpr double kRounding = 1e-4, kFlip = 0.02;  // of the image's range
  const torch::Tensor difference =
      torch::maximum(torch::amax((image.color - reference.color).abs(), {2}), (image.alpha - reference.alpha).abs());
  const double range = std::max(1.0, reference.color.abs().max().item<double>());
  const auto n_off = torch::logical_not(difference <= kRounding * range).sum().item<std::int64_t>();
  const double largest = difference.max().item<double>(), most = kFlip * range;
  // Splats on the other side of a threshold: at one pixel in ten thousand, and a few in small images.
  const std::int64_t allowed = 4 + difference.numel() / 10000;
  if (n_off <= allowed && largest <= most) return "";
  return detail::concat("its image differs in ", n_off, " pixels by up to ", largest, " (at most ", allowed,
                        " pixels and ", most, " can be rounding)");
}

std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference) {
  B3DGS_CHECK(sums.sizes() == reference.sizes(), "gradients of ", sums.sizes(), " and ", reference.sizes());
  constexpr double kRounding = 1e-3;  // of a column's norm
  const torch::Tensor off = (sums - reference).square().sum(0).sqrt(), norm = reference.square().sum(0).sqrt();
  const torch::Tensor agrees = off <= kRounding * norm + 1e-30;
  if (agrees.all().item<bool>()) return "";
  const double largest = (off / (norm + 1e-30)).max().item<double>();
  return detail::concat("its gradients differ by ", largest, " of their norm (at most ", kRounding,
                        " can be rounding)");
}

BlendPass forward_blend(const BlendInput& input) {
  return {[&](const CameraView& view) { input.render(view, input.settings); },
          [&](const std::string& kernel) {
            const RenderedView image = input.rasterizer.reblend(kernel_named(kForwardKernels, kernel));
            return Result{image.color, image.alpha};
          },
          [](const Result& image, const Result& kept) {
            return image_fault({image[0], {}, image[1]}, {kept[0], {}, kept[1]});
          }};
}

BlendPass backward_blend(const BlendInput& input) {
  const auto grad = std::make_shared<RenderedViewGrad>();
  return {[&, grad](const CameraView& view) {
            const torch::Tensor color = input.render(view, input.settings).color;
            // The amount of work does not depend on the gradient's values; this one is nonzero at every pixel.
            grad->color = torch::full_like(color, 1.0 / static_cast<double>(color.numel()));
          },
          [&, grad](const std::string& kernel) {
            return Result{input.rasterizer.reblend_backward(kernel_named(kBackwardKernels, kernel), *grad)};
          },
          [](const Result& sums, const Result& kept) { return gradient_fault(sums[0], kept[0]); }};
}

RunTimer make_run_timer(torch::Device device) {
  return [clock = make_stage_clock(device)](const std::vector<std::function<void()>>& runs) {
    std::vector<std::unique_ptr<StageMark>> marks;
    marks.push_back(clock());
    for (const std::function<void()>& run : runs) {
      run();
      marks.push_back(clock());
    }
    marks.back()->wait();
    std::vector<double> ms;
    for (std::size_t i = 0; i < runs.size(); ++i) ms.push_back(marks[i + 1]->ms_since(*marks[i]));
    return ms;
  };
}

namespace {

// The simplest kernels are the reference if candidates disagree.
constexpr const char *kForwardReference = "naive", *kBackwardReference = "per-pixel";

std::vector<std::string> backward_candidates(const TrainConfig& config, torch::Device device) {
  if (config.backward_kernel != kAdaptive) return {config.backward_kernel};
  if (device.is_cpu() || config.deterministic) return {kStandardBackwardKernel};
  return {kStandardBackwardKernel, kBackwardReference};
}

double ms_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

/// Compares the kernels' results on the prepared view and sets the fault of those that disagree.
void find_faults(const BlendPass& blend, const std::string& reference, std::vector<KernelMeasurement>& kernels) {
  const auto compare_with = [&](const std::string& kernel) {
    Result kept = blend.run(kernel);
    for (torch::Tensor& tensor : kept) tensor = tensor.clone();  // its memory is that of the next result
    bool agree = true;
    for (KernelMeasurement& other : kernels) {
      other.fault = other.kernel != kernel ? blend.fault(blend.run(other.kernel), kept) : "";
      agree = agree && other.fault.empty();
    }
    return agree;
  };
  // The reference may take longer than all others together, so it runs only if they disagree.
  if (!compare_with(kernels.front().kernel)) compare_with(reference);
}

std::vector<KernelMeasurement> unmeasured(const std::vector<std::string>& kernels) {
  std::vector<KernelMeasurement> measurements;
  for (const std::string& kernel : kernels) measurements.push_back({kernel, {}, {}});
  return measurements;
}

/// Calls work(), which times kernels. Does nothing if it fails: a view cannot be rendered, or memory is short.
void try_to_measure(const BlendInput& input, const std::function<void()>& work) {
  try {
    with_remedies(input.remedies, work);
  } catch (const NumericError&) {
  } catch (const OutOfMemoryError&) {
  }
}

}  // namespace

KernelChooser::KernelChooser(const TrainConfig& config, torch::Device device, RunTimer time_runs,
                             MakeBlend make_forward)
    : device_(device), time_runs_(time_runs ? std::move(time_runs) : make_run_timer(device)) {
  const bool is_open = chooses_forward_kernel(config);
  std::vector<std::string> forward = forward_candidates(config), backward = backward_candidates(config, device);
  // Times differ from run to run, and kernels differ in rounding.
  if (config.deterministic && is_open) forward = {kStandardKernel};
  const int n_choices = (forward.size() > 1) + (backward.size() > 1);
  KernelSelectorOptions options;
  options.policy = config.kernel_policy == "tracking" ? KernelPolicy::kTracking : KernelPolicy::kPaper;
  options.interval = config.kernel_check_interval;
  options.cost_share = kCostShare / std::max(1, n_choices);
  KernelSelectorOptions of_forward = options;
  if (config.kernel == kPublishedKernel) of_forward.policy = KernelPolicy::kPublished;
  of_forward.candidates = forward;
  of_forward.reference = kForwardReference;
  options.candidates = backward;
  options.reference = kBackwardReference;
  if (backward.size() == 1) backward.clear();
  passes_.push_back({"forward", KernelSelector(of_forward),
                     is_open ? forward_candidates(config) : config.kernel_candidates, std::move(make_forward)});
  passes_.push_back({"backward", KernelSelector(options), backward, backward_blend});
}

RenderSettings KernelChooser::apply(RenderSettings settings) const {
  settings.kernel = kernel_named(kForwardKernels, forward_name());
  if (!device_.is_cpu()) settings.backward_kernel = kernel_named(kBackwardKernels, backward_name());
  return settings;
}

std::string KernelChooser::backward_name() const {
  return device_.is_cpu() ? "" : passes_.back().selector.kernel();
}

bool KernelChooser::is_due(const CheckMoment& now) const {
  return std::any_of(passes_.begin(), passes_.end(), [&](const Pass& pass) { return pass.selector.is_due(now); });
}

std::vector<KernelDecision> KernelChooser::check(const CheckMoment& now, const BlendInput& input) {
  BlendInput own = input;
  own.settings = apply(input.settings);
  std::vector<Pass*> due;
  for (Pass& pass : passes_) {
    if (pass.selector.is_due(now)) due.push_back(&pass);
  }
  std::vector<KernelDecision> decisions;
  for (Pass* const pass : due) decisions.push_back(check_pass(*pass, now, own));
  return decisions;
}

double KernelChooser::warm_up(Pass& pass, const BlendPass& blend, const BlendInput& input) const {
  if (device_.is_cpu() || std::exchange(pass.is_warm, true)) return 0;
  const auto start = std::chrono::steady_clock::now();
  try_to_measure(input, [&] {  // the check that follows meets the same error
    blend.prepare(input.views.front());
    std::vector<KernelMeasurement> kernels = unmeasured(pass.selector.candidates());
    find_faults(blend, pass.selector.reference(), kernels);
  });
  time_runs_({});
  return ms_since(start);
}

KernelDecision KernelChooser::check_pass(Pass& pass, const CheckMoment& now, const BlendInput& input) const {
  KernelSelector& selector = pass.selector;
  const BlendPass blend = pass.make_blend(input);
  const double warm_up_ms = warm_up(pass, blend, input);
  time_runs_({});  // waits: the steps before are not part of the cost
  const auto start = std::chrono::steady_clock::now();
  const double budget_ms = selector.budget_ms(now.step_ms);
  const auto is_enough = [&](std::size_t n_views, const std::vector<KernelMeasurement>& so_far) {
    return n_views >= KernelSelector::kMinViews && (ms_since(start) > budget_ms || selector.is_clear(so_far));
  };
  std::vector<KernelMeasurement> found;
  try_to_measure(input,
                 [&] { found = measure(selector.candidates(), selector.reference(), blend, input.views, is_enough); });
  KernelDecision decision = selector.decide(now, found, ms_since(start));
  decision.pass = pass.name;
  decision.warm_up_ms = warm_up_ms;
  return decision;
}

std::vector<KernelMeasurement> KernelChooser::measure(const std::vector<std::string>& kernels,
                                                      const std::string& reference, const BlendPass& blend,
                                                      const std::vector<CameraView>& views,
                                                      const IsEnough& is_enough) const {
  std::vector<KernelMeasurement> found = unmeasured(kernels);
  std::vector<KernelMeasurement*> order;  // of the kernels that agree with the reference
  for (std::size_t i = 0; i < views.size() && !is_enough(i, found); ++i) {
    blend.prepare(views[i]);
    if (i == 0) {
      find_faults(blend, reference, found);
      for (KernelMeasurement& kernel : found) {
        if (kernel.fault.empty()) order.push_back(&kernel);
      }
      if (order.size() < 2) return found;
      blend.run(order.back()->kernel);  // keeps the device busy while the first timed run is queued
    }
    std::vector<std::function<void()>> runs;
    for (const KernelMeasurement* kernel : order) runs.emplace_back([&blend, kernel] { blend.run(kernel->kernel); });
    const std::vector<double> ms = time_runs_(runs);
    for (std::size_t k = 0; k < order.size(); ++k) order[k]->ms.push_back(ms.at(k));
    std::reverse(order.begin(), order.end());
  }
  return found;
}

std::vector<KernelTimes> KernelChooser::time_candidates(const BlendInput& input) const {
  BlendInput own = input;
  own.settings = apply(input.settings);
  std::vector<KernelTimes> times;
  for (const Pass& pass : passes_) {
    if (pass.timed.empty()) continue;
    const BlendPass blend = pass.make_blend(own);
    const IsEnough never = [](std::size_t, const std::vector<KernelMeasurement>&) { return false; };
    try_to_measure(own, [&] {
      times.push_back(summarize(measure(pass.timed, pass.selector.reference(), blend, own.views, never)));
      times.back().pass = pass.name;
    });
  }
  return times;
}

nlohmann::ordered_json KernelChooser::to_json() const {
  nlohmann::ordered_json json;
  for (const Pass& pass : passes_) json[pass.name] = pass.selector.to_json();
  return json;
}

void KernelChooser::restore(const nlohmann::ordered_json& json, const std::string& place) {
  for (Pass& pass : passes_) {
    if (json.contains(pass.name)) pass.selector.restore(json.at(pass.name), place);
  }
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
