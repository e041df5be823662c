// b3dgs bench: times the blending kernels and the passes of one view. bench sweep times the forward kernels over
// numbers of Gaussians and degrees of uneven load. Both run the rasterizer of training, on the CPU or a GPU.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "app/bench/bench_view.h"
#include "app/common/commands.h"
#include "app/common/torch/machine.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/parallel.h"
#include "raster/kernels.h"
#include "train/device.h"

namespace b3dgs {
namespace {

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

/// Rejects mistyped subcommands and built-in scenes, which would be mistaken for a folder. @throws InputError
void check_scene(const std::string& scene) {
  static const std::vector<std::string> kNames{"street", "spread", "kernels", "step", "sweep", "forecast", "paper"};
  if (std::find(kNames.begin(), kNames.end(), scene) != kNames.end() || std::filesystem::exists(scene)) return;
  const std::string nearest = nearest_name(scene, kNames);
  input_error("neither a scene nor a subcommand of bench: ", scene,
              nearest.empty() ? " (expected a COLMAP or model folder, street, spread, step, sweep, forecast or paper)"
                              : "; did you mean " + nearest + "?");
}

int run_bench_kernels(const std::vector<std::string>& words) {
  BenchConfig config;
  CommandLine line(
      "bench",
      "Time the kernels and the rendering passes on one view. `b3dgs bench forecast` says how long the presets train a "
      "scene here, `b3dgs bench step` times training steps by stage, `b3dgs bench sweep` the forward kernels for "
      "various numbers and distributions of Gaussians, `b3dgs bench paper` repeats the table of the paper.",
      "b3dgs bench street");
  line.add(config, "Benchmark", {"scene"});
  if (!line.parse(words)) return 0;
  check_scene(config.scene);
  config.device = device_name(choose_device(config.device));  // resolves auto
  set_compute_threads(config.threads);

  const BenchScene scene = make_bench_scene(config);
  std::printf("%s: %lld Gaussians, %d x %d px\n", scene.name.c_str(), static_cast<long long>(scene.cloud.size()),
              scene.view.width, scene.view.height);
  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  file.set("n_gaussians", scene.cloud.size());
  BenchView view(config, scene);
  view.render(kStandardKernel, /*keep=*/false);
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
  ComparisonTable forward("forward kernel");
  for (const KernelRow& kernel : kForwardKernels) {
    forward.add(view.measure(kernel));
    file.set(view.is_on_gpu() ? "forward" : "kernels", forward.rows());
  }
  if (view.is_on_gpu()) {
    ComparisonTable backward("backward kernel");
    for (const KernelFamily family : {KernelFamily::kPaper, KernelFamily::kOwn}) {
      backward.add(view.measure_backward(family));
    }
    file.set("backward", backward.rows());
  }
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
  for (const KernelRow& kernel : kForwardKernels) {
    view.render(kernel.kernel, /*keep=*/false);
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
  config.device = device_name(choose_device(config.device));  // resolves auto
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
      // Colours do not affect the time of blending, and SH degree 0 makes creating the scenes ten times faster.
      const BenchScene scene = make_spread_scene({points, skew, /*sh_degree=*/0, SpreadState::kFirstIteration}, config);
      BenchView view(config, scene);
      view.render(kStandardKernel, /*keep=*/false);
      if (cells.empty()) {
        std::printf("%d x %d px; %s\n", config.width, config.height, view.device_text().c_str());
        std::printf(
            "mean, max, Gini: Gaussians per tile and their Gini coefficient (0 = even); kernels: median ms; "
            "speedup: of the fastest kernel relative to naive\n");
        std::printf("%10s %5s | %7s %8s %5s |", "points", "skew", "mean", "max", "Gini");
        for (const KernelRow& kernel : kForwardKernels) std::printf(" %14s", std::string(kernel.name).c_str());
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
  if (what == "paper") return run_bench_paper(rest());
  if (what == "forecast") return run_bench_forecast(rest());
  return run_bench_kernels(what == "kernels" ? rest() : words);
}

}  // namespace b3dgs
