#include "app/bench/bench_view.h"

#include <cmath>
#include <memory>
#include <utility>

#include "core/check.h"
#include "core/parallel.h"
#include "train/device.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

/// Returns a copy in host memory, because the next pass overwrites the tensor.
torch::Tensor values_of(const torch::Tensor& tensor) {
  return tensor.to(torch::kCPU, torch::kFloat32, /*non_blocking=*/false, /*copy=*/true);
}

}  // namespace

BenchView::BenchView(const BenchRun& run, const BenchScene& scene)
    : device_(choose_device(run.device)),
      repeat_(run.repeat),
      view_(scene.view),
      gaussians_(to_tensors(scene.cloud, scene.cloud.sh_degree, device_)),
      rasterizer_(device_),
      clock_(make_stage_clock(device_)),
      stages_(make_stage_clock(device_)) {
  constexpr std::int64_t kFlushBytes = 256 << 20;  // several times the largest L2 cache
  const torch::TensorOptions options = torch::TensorOptions().device(device_);
  if (is_on_gpu()) flush_ = torch::empty({kFlushBytes}, options.dtype(torch::kUInt8));
  const double n_values = 3.0 * view_.width * view_.height;
  grad_.color = torch::full({view_.height, view_.width, 3}, 1 / n_values, options.dtype(torch::kFloat32));
  settings_.sh_degree = scene.cloud.sh_degree;
  settings_.culling = run.culling;
  settings_.depth_gradient = false;
  settings_.stages = &stages_;
}

std::string BenchView::device_text() const {
  return is_on_gpu() ? device_model(device_) : detail::concat("CPU, ", thread_count(), " threads");
}

void BenchView::render(ForwardKernel kernel, bool keep) {
  settings_.kernel = kernel;
  settings_.keep_for_backward = keep;
  rendered_ = rasterizer_.forward(gaussians_, view_, settings_);
}

Measurement BenchView::measure(const KernelRow& kernel) {
  render(kernel.kernel, /*keep=*/false);
  Measurement measured{std::string(kernel.name), time_blend(kernel.kernel)};
  if (is_on_gpu()) {
    render(kernel.kernel, /*keep=*/true);
    measured.keeping = time_blend(kernel.kernel);
  }
  for (const torch::Tensor& image : {rendered_.color, rendered_.depth, rendered_.alpha}) {
    image.fill_(NAN);  // reveals pixels that a kernel does not write
  }
  rasterizer_.reblend(kernel.kernel);
  measured.image = values_of(rendered_.color);
  if (is_on_gpu()) measured.gradients = gradients();
  return measured;
}

Measurement BenchView::measure_backward(KernelFamily family) {
  render(family == KernelFamily::kPaper ? ForwardKernel::kSharedMemory : kStandardKernel, /*keep=*/true);
  const Timing timing = time([&] { rasterizer_.reblend_backward(grad_); });
  return {std::string(backward_kernel_of(family)), timing, torch::Tensor(), gradients()};
}

std::vector<StageTimes> BenchView::run_passes() {
  std::vector<StageTimes> times;
  for (int i = -1; i < repeat_; ++i) {  // the first run is the warm-up
    flush_cache();
    stages_.start(StageTimes::Kind::kStep);
    render(kStandardKernel, /*keep=*/true);
    rasterizer_.backward(gaussians_, grad_, gradients_);
    stages_.finish();
    const StageTimes step = stages_.wait().front();
    if (i >= 0) times.push_back(step);
  }
  return times;
}

Timing BenchView::time(const std::function<void()>& run) {
  std::vector<double> ms;
  for (int i = -1; i < repeat_; ++i) {
    flush_cache();
    const std::unique_ptr<StageMark> from = clock_();
    run();
    const std::unique_ptr<StageMark> to = clock_();
    to->wait();
    if (i >= 0) ms.push_back(to->ms_since(*from));
  }
  return summarize(std::move(ms));
}

std::vector<ParameterGradient> BenchView::gradients() {
  rasterizer_.backward(gaussians_, grad_, gradients_);
  std::vector<ParameterGradient> all;
  for (const torch::Tensor* const own : gradients_.all()) {
    all.push_back({values_of(*own)});
    // For nearly spherical Gaussians, gradients of the rotation are only rounding errors, about as large as those in
    // the gradients of the scales. Therefore differences are relative to the latter.
    if (own == &gradients_.quats) all.back().size = gradients_.log_scales.abs().max().item<double>();
  }
  return all;
}

}  // namespace b3dgs
