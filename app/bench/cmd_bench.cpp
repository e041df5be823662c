// b3dgs bench: times the blending kernels and the passes of one view, or, as bench sweep, the forward kernels over
// numbers of Gaussians and degrees of uneven load.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <vector>

#include "app/bench/bench_view.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "raster/kernels.h"
#include "train/device.h"

namespace b3dgs {
namespace {

/// A mistyped subcommand or built-in scene would be taken for a folder. @throws InputError
void check_scene(const std::string& scene) {
  static const std::vector<std::string> kNames{"street", "spread", "kernels", "step", "sweep", "exchange"};
  if (std::find(kNames.begin(), kNames.end(), scene) != kNames.end() || std::filesystem::exists(scene)) return;
  const std::string nearest = nearest_name(scene, kNames);
  input_error("neither a scene nor a subcommand of bench: ", scene,
              nearest.empty() ? " (expected a COLMAP or model folder, street, spread, step, sweep or exchange)"
                              : "; did you mean " + nearest + "?");
}

int run_bench_kernels(const std::vector<std::string>& words) {
  BenchConfig config;
  CommandLine line(
      "bench",
      "Time the kernels and the rendering passes on one view. `b3dgs bench step` times training steps by stage, `b3dgs "
      "bench sweep` times the forward kernels for various numbers and distributions of Gaussians, `b3dgs bench "
      "exchange` what several processes exchange.",
      "b3dgs bench street");
  line.add(config, "Benchmark", {"scene"});
  if (!line.parse(words)) return 0;
  if (config.scene == "balanced") {  // its former name
    std::fprintf(stderr, "the scene balanced is now spread\n");
    config.scene = "spread";
  }
  check_scene(config.scene);
  resolve_auto(config);
  set_compute_threads(config.threads);

  const BenchScene scene = make_bench_scene(config);
  std::printf("%s: %lld Gaussians, %d x %d px, tiles of %d x %d px\n", scene.name.c_str(),
              static_cast<long long>(scene.cloud.size()), scene.view.width, scene.view.height, config.tile_width,
              config.tile_height);
  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  file.set("n_gaussians", scene.cloud.size());
  bench_kernels(config, scene, file);
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

std::vector<int> default_points(const std::string& device) {
  return device == "cuda" ? std::vector<int>{250000, 1000000, 4000000} : std::vector<int>{25000, 100000, 400000};
}

/// Index in kForwardKernels.
std::size_t fastest_of(const ForwardTimes& times) {
  const auto fastest = std::min_element(times.kernels.begin(), times.kernels.end(),
                                        [](const Timing& a, const Timing& b) { return a.median_ms < b.median_ms; });
  return static_cast<std::size_t>(fastest - times.kernels.begin());
}

void print_head() {
  std::printf(
      "mean, max, Gini: Gaussians per tile and their Gini coefficient (0 = even); kernels: median ms; speedup: of the "
      "fastest kernel relative to naive\n");
  std::printf("%10s %5s | %7s %8s %5s |", "points", "skew", "mean", "max", "Gini");
  for (const ForwardKernelName& kernel : kForwardKernels) std::printf(" %14s", std::string(kernel.name).c_str());
  std::printf(" | %-14s %s\n", "fastest", "speedup");
}

void print_cell(int points, double skew, const ForwardTimes& times) {
  std::printf("%10d %5.2f | %7.0f %8lld %5.2f |", points, skew, times.lists["mean"].get<double>(),
              times.lists["max"].get<long long>(), times.lists["gini"].get<double>());
  for (const Timing& timing : times.kernels) std::printf(" %14.3f", timing.median_ms);
  const std::size_t fastest = fastest_of(times);
  std::printf(" | %-14s %7.2f\n", std::string(kForwardKernels[fastest].name).c_str(),
              times.kernels.front().median_ms / times.kernels[fastest].median_ms);
}

nlohmann::ordered_json cell_to_json(int points, double skew, const ForwardTimes& times) {
  nlohmann::ordered_json kernels = nlohmann::ordered_json::array();
  for (std::size_t i = 0; i < times.kernels.size(); ++i) {
    kernels.push_back(to_json(times.kernels[i], {{"kernel", std::string(kForwardKernels[i].name)}}));
  }
  return {{"points", points},
          {"skew", skew},
          {"lists", times.lists},
          {"kernels", kernels},
          {"fastest", std::string(kForwardKernels[fastest_of(times)].name)}};
}

}  // namespace

int run_bench_sweep(const std::vector<std::string>& words) {
  SweepConfig config;
  CommandLine line("bench sweep",
                   "Time every forward kernel on a grid of synthetic scenes, by number and distribution of Gaussians, "
                   "in the state of "
                   "a first iteration. Times are in ms, list lengths in Gaussians per tile.",
                   "b3dgs bench sweep --json sweep.json");
  line.add(config, "Benchmark");
  if (!line.parse(words)) return 0;
  if (config.skew.empty()) input_error("--skew needs at least one value");
  resolve_auto(config);
  if (config.points.empty()) config.points = default_points(config.device);
  set_compute_threads(config.threads);

  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  nlohmann::ordered_json cells = nlohmann::ordered_json::array();
  for (const int points : config.points) {
    for (const double skew : config.skew) {
      // Colours do not affect the time of blending; SH degree 0 makes creating the scenes ten times faster.
      const BenchScene scene = make_spread_scene({points, skew, /*sh_degree=*/0, SpreadState::kFirstIteration}, config);
      const ForwardTimes times = time_forward_kernels(config, scene);
      if (cells.empty()) {
        std::printf("%d x %d px, tiles of %d x %d px; %s\n", config.width, config.height, config.tile_width,
                    config.tile_height, times.device.c_str());
        print_head();
        file.set("device", times.device);
      }
      print_cell(points, skew, times);
      cells.push_back(cell_to_json(points, skew, times));
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
  if (what == "exchange") return run_bench_exchange(rest());
  return run_bench_kernels(what == "kernels" ? rest() : words);
}

}  // namespace b3dgs
