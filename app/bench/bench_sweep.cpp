// b3dgs bench sweep: times the forward kernels over numbers of Gaussians and degrees of uneven load.
#include <algorithm>
#include <cstdio>
#include <vector>

#include "app/bench/bench_devices.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/parallel.h"
#include "raster/kernels.h"

namespace b3dgs {
namespace {

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

const ForwardTimes::Row& fastest_of(const ForwardTimes& times) {
  return *std::min_element(times.rows.begin(), times.rows.end(),
                           [](const auto& a, const auto& b) { return a.timing.median_ms < b.timing.median_ms; });
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
  for (const ForwardTimes::Row& row : times.rows) std::printf(" %14.3f", row.timing.median_ms);
  const ForwardTimes::Row& fastest = fastest_of(times);
  std::printf(" | %-14s %7.2f\n", fastest.kernel.c_str(),
              times.rows.front().timing.median_ms / fastest.timing.median_ms);
}

nlohmann::ordered_json cell_to_json(int points, double skew, const ForwardTimes& times) {
  nlohmann::ordered_json kernels = nlohmann::ordered_json::array();
  for (const ForwardTimes::Row& row : times.rows) kernels.push_back(to_json(row.timing, {{"kernel", row.kernel}}));
  return {{"points", points},
          {"skew", skew},
          {"lists", times.lists},
          {"kernels", kernels},
          {"fastest", fastest_of(times).kernel}};
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
  set_thread_count(config.threads);

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

}  // namespace b3dgs
