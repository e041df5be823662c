// b3dgs bench: times the blending kernels and the passes of one view, or, as bench sweep, the forward kernels over
// numbers of Gaussians and degrees of uneven load. The rasterizer of training runs them, on the CPU or a GPU.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "app/record_run.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/parallel.h"
#include "raster/kernels.h"
#include "raster/torch/rasterizer.h"
#include "train/device.h"
#include "train/gaussians/gaussian_model.h"
#include "train/timing/timers.h"

namespace b3dgs {
namespace {

/// A copy in host memory: the next pass overwrites the tensor.
torch::Tensor values_of(const torch::Tensor& tensor) {
  return tensor.to(torch::kCPU, torch::kFloat32, /*non_blocking=*/false, /*copy=*/true);
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
    constexpr std::int64_t kFlushBytes = 256 << 20;  // several times the largest L2 cache
    const torch::TensorOptions options = torch::TensorOptions().device(device_);
    if (is_on_gpu()) flush_ = torch::empty({kFlushBytes}, options.dtype(torch::kUInt8));
    const double n_values = 3.0 * view_.width * view_.height;
    grad_.color = torch::full({view_.height, view_.width, 3}, 1 / n_values, options.dtype(torch::kFloat32));
    settings_.sh_degree = scene.cloud.sh_degree;
    settings_.culling = run.culling == "square" ? Culling::kSquare : Culling::kEllipse;
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
  nlohmann::ordered_json lists() const { return list_statistics(rasterizer_.count_load().tile_lists); }

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
    Measurement measured{std::string(kernel.name), time_blend(kernel.kernel)};
    if (is_on_gpu()) {
      render(kernel.kernel, /*keep=*/true);
      measured.keeping = time_blend(kernel.kernel);
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
    return {std::string(kernel.name), timing, torch::Tensor(), gradients()};
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
      const std::unique_ptr<StageMark> from = clock_();
      run();
      const std::unique_ptr<StageMark> to = clock_();
      to->wait();
      if (i >= 0) ms.push_back(to->ms_since(*from));
    }
    return summarize(std::move(ms));
  }

  std::vector<ParameterGradient> gradients() {
    rasterizer_.backward(gaussians_, grad_, gradients_);
    std::vector<ParameterGradient> all;
    for (const torch::Tensor* const own : gradients_.all()) {
      all.push_back({values_of(*own)});
      // For nearly spherical Gaussians, gradients of the rotation are only rounding errors, of about the size of those
      // in the gradients of the scales. Differences are therefore taken relative to the latter.
      if (own == &gradients_.quats) all.back().size = gradients_.log_scales.abs().max().item<double>();
    }
    return all;
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
  StageClock clock_;
  StageTimer stages_;
};

void time_passes(BenchView& view, BenchFile& file) {
  const std::vector<StageTimes> times = view.run_passes();
  nlohmann::ordered_json rows;
  double sum_ms = 0;
  std::printf("\n%-16s %10s %23s\n", "pass", "median ms", "min .. max");
  for (const Stage stage :
       {Stage::kProject, Stage::kBin, Stage::kBlendForward, Stage::kBlendBackward, Stage::kProjectBackward}) {
    std::string name = kStageNames[static_cast<std::size_t>(stage)];
    std::replace(name.begin(), name.end(), '_', ' ');
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

/// A mistyped subcommand or built-in scene would be taken for a folder. @throws InputError
void check_scene(const std::string& scene) {
  static const std::vector<std::string> kNames{"street", "spread", "kernels", "step", "sweep"};
  if (std::find(kNames.begin(), kNames.end(), scene) != kNames.end() || std::filesystem::exists(scene)) return;
  const std::string nearest = nearest_name(scene, kNames);
  input_error("neither a scene nor a subcommand of bench: ", scene,
              nearest.empty() ? " (expected a COLMAP or model folder, street, spread, step or sweep)"
                              : "; did you mean " + nearest + "?");
}

int run_bench_kernels(const std::vector<std::string>& words) {
  BenchConfig config;
  CommandLine line(
      "bench",
      "Time the kernels and the rendering passes on one view. `b3dgs bench step` times training steps by stage, `b3dgs "
      "bench sweep` the forward kernels for various numbers and distributions of Gaussians.",
      "b3dgs bench street");
  line.add(config, "Benchmark", {"scene"});
  if (!line.parse(words)) return 0;
  check_scene(config.scene);
  config.device = device_name(choose_device(config.device));  // of auto
  set_compute_threads(config.threads);

  const BenchScene scene = make_bench_scene(config);
  std::printf("%s: %lld Gaussians, %d x %d px\n", scene.name.c_str(), static_cast<long long>(scene.cloud.size()),
              scene.view.width, scene.view.height);
  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  file.set("n_gaussians", scene.cloud.size());
  BenchView view(config, scene);
  view.render(ForwardKernel::kNaive, /*keep=*/false);
  const nlohmann::ordered_json lists = view.lists();
  std::printf("%lld visible Gaussians; %s\n", static_cast<long long>(view.n_splats()), view.device_text().c_str());
  std::printf(
      "Gaussians per tile: mean %.0f, median %lld, 90th percentile %lld, 99th percentile %lld, maximum %lld, Gini "
      "coefficient %.2f; %lld (tile, splat) pairs\n",
      lists["mean"].get<double>(), lists["median"].get<long long>(), lists["p90"].get<long long>(),
      lists["p99"].get<long long>(), lists["max"].get<long long>(), lists["gini"].get<double>(),
      lists["pairs"].get<long long>());
  file.set("machine", describe_machine(view.device()));
  file.set("lists", lists);
  file.set("n_splats", view.n_splats());
  file.set("threads", thread_count());
  const auto compare = [&](const char* title, const char* key, const auto& kernels) {
    ComparisonTable table(title);
    for (const auto& kernel : kernels) {
      table.add(view.measure(kernel));
      file.set(key, table.rows());
    }
  };
  compare("forward kernel", view.is_on_gpu() ? "forward" : "kernels", kForwardKernels);
  if (view.is_on_gpu()) compare("backward kernel", "backward", kBackwardKernels);
  time_passes(view, file);
  return 0;
}

struct SweepConfig : BenchRun {
  std::vector<int> points;
  std::vector<double> skew{0, 0.25, 0.5, 0.75, 1};
};

template <class Visitor>
void visit_fields(SweepConfig& c, Visitor&& field) {
  field(Option{"points"}, c.points, AtLeast{1},
        "numbers of Gaussians (none = 250000 1000000 4000000; on a CPU a tenth of them)");
  field(Option{"skew"}, c.skew, InRange{0, 2},
        "density ~ (distance from image centre)^(-2 X); 0: even, 1: like street");
  visit_fields(static_cast<BenchRun&>(c), field);
}

/// Prints a row of the table and returns it as JSON.
nlohmann::ordered_json time_cell(int points, double skew, BenchView& view) {
  const nlohmann::ordered_json lists = view.lists();
  std::vector<Timing> timings;
  nlohmann::ordered_json kernels;
  for (const ForwardKernelName& kernel : kForwardKernels) {
    timings.push_back(view.time_blend(kernel.kernel));
    kernels.push_back(to_json(timings.back(), {{"kernel", std::string(kernel.name)}}));
  }
  const auto fastest = std::min_element(timings.begin(), timings.end(),
                                        [](const Timing& a, const Timing& b) { return a.median_ms < b.median_ms; });
  const std::string name(kForwardKernels[static_cast<std::size_t>(fastest - timings.begin())].name);
  std::printf("%10d %5.2f | %7.0f %8lld %5.2f |", points, skew, lists["mean"].get<double>(),
              lists["max"].get<long long>(), lists["gini"].get<double>());
  for (const Timing& timing : timings) std::printf(" %14.3f", timing.median_ms);
  std::printf(" | %-14s %7.2f\n", name.c_str(), timings.front().median_ms / fastest->median_ms);
  return {{"points", points}, {"skew", skew}, {"lists", lists}, {"kernels", kernels}, {"fastest", name}};
}

}  // namespace

int run_bench_sweep(const std::vector<std::string>& words) {
  SweepConfig config;
  CommandLine line("bench sweep",
                   "Time every forward kernel on a grid of synthetic scenes, by number and distribution of Gaussians, "
                   "in the state of a first iteration. Times are in ms, list lengths in Gaussians per tile.",
                   "b3dgs bench sweep --json sweep.json");
  line.add(config, "Benchmark");
  if (!line.parse(words)) return 0;
  if (config.skew.empty()) input_error("--skew needs at least one value");
  config.device = device_name(choose_device(config.device));  // of auto
  if (config.points.empty()) {
    const int least = config.device == "cuda" ? 250000 : 25000;
    config.points = {least, 4 * least, 16 * least};
  }
  set_compute_threads(config.threads);

  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  nlohmann::ordered_json cells = nlohmann::ordered_json::array();
  for (const int points : config.points) {
    for (const double skew : config.skew) {
      // Colours do not affect the time of blending; SH degree 0 makes creating the scenes ten times faster.
      const BenchScene scene = make_spread_scene({points, skew, /*sh_degree=*/0, SpreadState::kFirstIteration}, config);
      BenchView view(config, scene);
      view.render(ForwardKernel::kNaive, /*keep=*/false);
      if (cells.empty()) {
        std::printf("%d x %d px; %s\n", config.width, config.height, view.device_text().c_str());
        std::printf(
            "mean, max, Gini: Gaussians per tile and their Gini coefficient (0 = even); kernels: median ms; "
            "speedup: of the fastest kernel relative to naive\n");
        std::printf("%10s %5s | %7s %8s %5s |", "points", "skew", "mean", "max", "Gini");
        for (const ForwardKernelName& kernel : kForwardKernels) std::printf(" %14s", std::string(kernel.name).c_str());
        std::printf(" | %-14s %s\n", "fastest", "speedup");
        file.set("device", view.device_text());
      }
      cells.push_back(time_cell(points, skew, view));
      file.set("cells", cells);
    }
  }
  return 0;
}

int run_bench(const std::vector<std::string>& words) {
  std::setvbuf(stdout, nullptr, _IOLBF, BUFSIZ);  // shows each row immediately, even through a pipe
  const std::string what = words.empty() ? "" : words.front();
  const auto rest = [&] { return std::vector<std::string>(words.begin() + 1, words.end()); };
  if (what == "sweep") return run_bench_sweep(rest());
  if (what == "step") return run_bench_step(rest());
  return run_bench_kernels(what == "kernels" ? rest() : words);
}

}  // namespace b3dgs
