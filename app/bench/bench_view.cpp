#include "app/bench/bench_view.h"

#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <optional>
#include <type_traits>
#include <utility>

#include "app/record_run.h"
#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/rasterizer.h"
#include "train/device.h"
#include "train/gaussians/gaussian_model.h"
#include "train/timing/timers.h"
#if B3DGS_TORCH_CUDA
#include "raster/cuda/blend_kernels.h"
#endif

namespace b3dgs {
namespace {

template <class Kernel>
std::optional<cuda::KernelResources> resources_of([[maybe_unused]] Kernel kernel,
                                                  [[maybe_unused]] const TileShape& tile) {
#if B3DGS_TORCH_CUDA
  const auto row = static_cast<std::size_t>(kernel);
  if constexpr (std::is_same_v<Kernel, ForwardKernel>) return cuda::kForwardTable[row].resources(tile);
  if constexpr (std::is_same_v<Kernel, BackwardKernel>) return cuda::kBackwardTable[row].resources(tile);
#endif
  return std::nullopt;
}

std::vector<float> values_of(const torch::Tensor& tensor) {
  const torch::Tensor host = tensor.to(torch::kCPU).contiguous();
  return {host.data_ptr<float>(), host.data_ptr<float>() + host.numel()};
}

/// One view of a scene on a device. The loss is the mean of all colour values.
class BenchView {
 public:
  BenchView(const BenchRun& run, const BenchScene& scene)
      : device_(choose_device(run.device)),
        repeat_(run.repeat),
        view_(scene.view),
        gaussians_(to_tensors(scene.cloud, scene.cloud.sh_degree, device_)),
        rasterizer_(device_),
        clock_(make_stage_clock(device_)),
        stages_(make_stage_clock(device_)) {
    if (is_on_gpu() && (run.tile_width != 16 || (run.tile_height != 8 && run.tile_height != 16))) {
      input_error("tiles of ", run.tile_width, " x ", run.tile_height,
                  " px are not supported on a GPU (expected 16x16 or 16x8)");
    }
    constexpr std::int64_t kFlushBytes = 256 << 20;  // several times the largest L2 cache
    const torch::TensorOptions options = torch::TensorOptions().device(device_);
    if (is_on_gpu()) flush_ = torch::empty({kFlushBytes}, options.dtype(torch::kUInt8));
    const double n_values = 3.0 * view_.width * view_.height;
    grad_.color = torch::full({view_.height, view_.width, 3}, 1 / n_values, options.dtype(torch::kFloat32));
    settings_.sh_degree = scene.cloud.sh_degree;
    settings_.culling = run.culling == "square" ? Culling::kSquare : Culling::kEllipse;
    settings_.tile = {run.tile_width, run.tile_height};
    settings_.depth_gradient = false;
    settings_.stages = &stages_;
  }

  bool is_on_gpu() const { return device_.is_cuda(); }
  const torch::Device& device() const { return device_; }
  std::string device_text() const {
    if (is_on_gpu()) return describe_machine(device_).value("gpu", "GPU");
    return detail::concat("CPU, ", thread_count(), " threads");
  }

  std::int64_t n_splats() const { return rasterizer_.view_size().n_splats; }
  nlohmann::ordered_json lists() const {
    const torch::Tensor lengths = rasterizer_.count_load().tile_lists.contiguous();
    const std::int64_t* const first = lengths.data_ptr<std::int64_t>();
    return list_statistics({first, first + lengths.numel()});
  }

  /// A forward pass. `keep`: as in a training step, it stores what a backward pass needs.
  void render(ForwardKernel kernel, bool keep) {
    settings_.kernel = kernel;
    settings_.keep_for_backward = keep;
    rendered_ = rasterizer_.forward(gaussians_, view_, settings_);
  }

  /// Of the blending in the last render().
  Timing time_blend(ForwardKernel kernel) {
    return time([&] { rasterizer_.reblend(kernel); });
  }

  Measurement measure(const ForwardKernelName& kernel) {
    render(kernel.kernel, /*keep=*/false);
    Measurement measured{std::string(kernel.name), time_blend(kernel.kernel), {}, {}};
    if (is_on_gpu()) {
      render(kernel.kernel, /*keep=*/true);
      measured.keeping = time_blend(kernel.kernel);
      measured.resources = resources_of(kernel.kernel, settings_.tile);
    }
    for (const torch::Tensor& image : {rendered_.color, rendered_.depth, rendered_.alpha}) {
      image.fill_(NAN);  // shows where a kernel writes nothing
    }
    rasterizer_.reblend(kernel.kernel);
    measured.image = values_of(rendered_.color);
    if (is_on_gpu()) measured.gradients = gradients();
    return measured;
  }

  /// On a GPU.
  Measurement measure(const BackwardKernelName& kernel) {
    settings_.backward_kernel = kernel.kernel;
    render(ForwardKernel::kSharedMemory, /*keep=*/true);
    const Timing timing = time([&] { rasterizer_.reblend_backward(kernel.kernel, grad_); });
    return {std::string(kernel.name), timing, {}, gradients(), resources_of(kernel.kernel, settings_.tile)};
  }

  /// Times of the passes of whole views, as in a training step.
  std::vector<StageTimes> run_passes() {
    settings_.backward_kernel = BackwardKernel::kPerBucket;
    std::vector<StageTimes> times;
    for (int i = -1; i < repeat_; ++i) {  // the first warms up
      flush_cache();
      stages_.start(StageTimes::Kind::kStep);
      render(ForwardKernel::kSharedMemory, /*keep=*/true);
      rasterizer_.backward(gaussians_, grad_, gradients_);
      stages_.finish();
      const StageTimes step = stages_.wait().front();
      if (i >= 0) times.push_back(step);
    }
    return times;
  }

 private:
  void flush_cache() {
    if (flush_.defined()) flush_.zero_();
  }

  /// One warm-up run, then the timed ones.
  Timing time(const std::function<void()>& run) {
    std::vector<double> ms;
    for (int i = -1; i < repeat_; ++i) {
      flush_cache();
      const int from = clock_->mark();
      run();
      const int to = clock_->mark();
      clock_->wait(to);
      if (i >= 0) ms.push_back(clock_->ms_between(from, to));
      clock_->release(from);
      clock_->release(to);
    }
    return summarize(std::move(ms));
  }

  std::vector<NamedArray> gradients() {
    rasterizer_.backward(gaussians_, grad_, gradients_);
    std::vector<NamedArray> arrays;
    for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
      arrays.push_back({GaussianTensors::kNames[i], values_of(*gradients_.all()[i])});
      // For nearly spherical Gaussians, gradients of the rotation are only rounding errors, of about the size of those
      // in the gradients of the scales. Differences are therefore taken relative to the latter.
      if (arrays.back().name == "quats") arrays.back().size = gradients_.log_scales.abs().max().item<double>();
    }
    return arrays;
  }

  const torch::Device device_;
  const int repeat_;
  const CameraView view_;
  const GaussianTensors gaussians_;
  GaussianTensors gradients_;
  Rasterizer rasterizer_;
  RenderSettings settings_;
  RenderedView rendered_;
  RenderedViewGrad grad_;
  torch::Tensor flush_;
  std::unique_ptr<StageClock> clock_;
  StageTimer stages_;
};

void time_passes(BenchView& view, BenchFile& file) {
  constexpr std::pair<Stage, const char*> kPasses[]{{Stage::kProject, "project"},
                                                    {Stage::kBin, "bin"},
                                                    {Stage::kBlendForward, "blend forward"},
                                                    {Stage::kBlendBackward, "blend backward"},
                                                    {Stage::kProjectBackward, "project backward"}};
  const std::vector<StageTimes> times = view.run_passes();
  nlohmann::ordered_json rows;
  double sum_ms = 0;
  std::printf("\n%-16s %10s %23s\n", "pass", "median ms", "min .. max");
  for (const auto& [stage, name] : kPasses) {
    std::vector<double> ms;
    for (const StageTimes& step : times) ms.push_back(step.ms[static_cast<std::size_t>(stage)].value_or(0));
    const Timing timing = summarize(std::move(ms));
    print_timing(name, timing);
    std::printf("\n");
    rows.push_back(to_json(timing, {{"pass", name}}));
    sum_ms += timing.median_ms;
  }
  std::printf("%-16s %10.3f\n", "forward+backward", sum_ms);
  file.set("passes", rows);
}

/// Each kernel is compared with the first. `key`: in the file.
template <class Kernels>
void compare_kernels(const char* title, const char* key, const Kernels& kernels, BenchView& view, BenchFile& file) {
  ComparisonTable table(title);
  for (const auto& kernel : kernels) {
    table.add(view.measure(kernel));
    file.set(key, table.rows());
  }
}

}  // namespace

void bench_kernels(const BenchRun& run, const BenchScene& scene, BenchFile& file) {
  BenchView view(run, scene);
  view.render(ForwardKernel::kNaive, /*keep=*/false);
  const nlohmann::ordered_json lists = view.lists();
  std::printf("%lld visible Gaussians; %s\n", static_cast<long long>(view.n_splats()), view.device_text().c_str());
  print_list_statistics(lists);
  file.set("machine", describe_machine(view.device()));
  file.set("lists", lists);
  file.set("n_splats", view.n_splats());
  file.set("threads", thread_count());
  compare_kernels("forward kernel", view.is_on_gpu() ? "forward" : "kernels", kForwardKernels, view, file);
  if (view.is_on_gpu()) compare_kernels("backward kernel", "backward", kBackwardKernels, view, file);
  time_passes(view, file);
}

ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene) {
  BenchView view(run, scene);
  view.render(ForwardKernel::kNaive, /*keep=*/false);
  ForwardTimes times{view.device_text(), view.lists(), {}};
  for (const ForwardKernelName& kernel : kForwardKernels) times.kernels.push_back(view.time_blend(kernel.kernel));
  return times;
}

}  // namespace b3dgs
