// b3dgs bench paper: repeats Table 1 of Balanced 3DGS (arXiv 2412.17378), the time and occupancy of its forward kernels
// in a first training iteration, and adds its shared-memory kernel.
#include <cstdio>
#include <optional>
#include <string>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "app/bench/bench_view.h"
#include "app/common/commands.h"
#include "app/common/torch/machine.h"
#include "core/options/command_line.h"
#include "core/parallel.h"
#include "train/device.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

struct PaperConfig : BenchRun {
  std::int64_t points = 1500000;
  PaperConfig() { culling = Culling::kSquare; }  // as in the rasterizer on which the paper is based
};

template <class Visitor>
void visit_fields(PaperConfig& c, Visitor&& field) {
  field(Option{"points"}, c.points, AtLeast{1}, "number of LiDAR-like points, from which Gaussians are initialised");
  visit_fields(static_cast<BenchRun&>(c), field);
}

/// Values printed in the paper, measured on an A100 80 GB.
struct PrintedRow {
  double ms, theoretical, achieved;  // occupancies: %
  const char* limiter;
};

struct TableRow {
  const char* label;
  ForwardKernel kernel;
  std::optional<PrintedRow> printed;
};

constexpr const char* kImbalance = "load imbalance";
const TableRow kRows[] = {
    {"(a)", ForwardKernel::kNaive, PrintedRow{125.50, 100.00, 22.60, kImbalance}},
    {"(b)", ForwardKernel::kDynamic, PrintedRow{120.00, 75.00, 19.82, kImbalance}},
    {"(c)", ForwardKernel::kGaussianWise, PrintedRow{107.36, 31.25, 18.85, kImbalance}},
    {"(d)", ForwardKernel::kCombined, PrintedRow{16.69, 62.50, 55.02, "registers"}},
    {"(s)", ForwardKernel::kSharedMemory, std::nullopt},
};

Json to_json(const KernelOccupancy& occupancy) {
  return {{"registers", occupancy.registers}, {"shared_bytes", occupancy.shared_bytes},
          {"blocks", occupancy.blocks},       {"theoretical", occupancy.theoretical},
          {"limiter", occupancy.limiter},     {"achieved", occupancy.achieved},
          {"active", occupancy.active}};
}

Json show_row(const TableRow& row, BenchView& view, double naive_ms, const Timing& timing) {
  const std::string name(kernel_name(row.kernel));
  const double speedup = naive_ms / timing.median_ms;
  Json json = to_json(timing, {{"row", row.label}, {"kernel", name}, {"speedup", speedup}});
  std::printf("%s %-13s %8.3f %7.2fx", row.label, name.c_str(), timing.median_ms, speedup);
  if (view.is_on_gpu()) {
    const KernelOccupancy occupancy = view.measure_occupancy(row.kernel);
    json["occupancy"] = to_json(occupancy);
    std::printf(" %11.2f %% %-13s %8.2f %% %8.1f %%", 100 * occupancy.theoretical, occupancy.limiter,
                100 * occupancy.achieved, 100 * occupancy.active);
  }
  if (row.printed) {
    const PrintedRow& printed = *row.printed;
    const double printed_speedup = kRows[0].printed->ms / printed.ms;
    json["paper"] = {{"ms", printed.ms},
                     {"speedup", printed_speedup},
                     {"theoretical", 0.01 * printed.theoretical},
                     {"achieved", 0.01 * printed.achieved},
                     {"limiter", printed.limiter}};
    std::printf(" | %7.2f %6.2fx %7.2f %% %7.2f %%  %s", printed.ms, printed_speedup, printed.theoretical,
                printed.achieved, printed.limiter);
  }
  std::printf("\n");
  return json;
}

}  // namespace

int run_bench_paper(const std::vector<std::string>& words) {
  PaperConfig config;
  CommandLine line("bench paper",
                   "Repeat Table 1 of the Balanced 3DGS paper: time and occupancy of its forward kernels on 16 x 8 "
                   "patches with 128 threads, in the first iteration on LiDAR-like points, beside the figures that it "
                   "prints. On a CPU, only times are measured.",
                   "b3dgs bench paper --points 4000000 --json table.json");
  line.add(config, "Benchmark");
  if (!line.parse(words)) return 0;
  config.device = device_name(choose_device(config.device));  // resolves auto
  set_compute_threads(config.threads);

  BenchConfig of_scene;
  static_cast<BenchRun&>(of_scene) = config;
  of_scene.points = config.points;
  const BenchScene scene = make_bench_scene(of_scene);
  BenchView view(config, scene);
  BenchFile file(config.json);
  view.render(ForwardKernel::kNaive, /*keep=*/false);
  const Json lists = view.lists();
  std::printf("%lld LiDAR-like points, first iteration, %d x %d px, culling by %s, %s\n",
              static_cast<long long>(scene.cloud.size()), scene.view.width, scene.view.height,
              name_of(config.culling).c_str(), view.device_text().c_str());
  std::printf(
      "%lld patches of 16 x 8 px; Gaussians per patch: mean %.0f, median %lld, 99th percentile %lld, maximum "
      "%lld\n\n",
      lists["tiles"].get<long long>(), lists["mean"].get<double>(), lists["median"].get<long long>(),
      lists["p99"].get<long long>(), lists["max"].get<long long>());
  file.set("config", config_to_json(config));
  file.set("machine", describe_machine(view.device()));
  file.set("lists", lists);
  const char* const measured = view.is_on_gpu() ? " theoretical   limited by      achieved  SMs busy" : "";
  const char* const printed = " |    in the paper, on an A100: ms, speed-up, theoretical, achieved, limited by";
  std::printf("    %-13s %8s %8s%s%s\n", "kernel", "ms", "speed-up", measured, printed);
  Json rows = Json::array();
  double naive_ms = 0;
  for (const TableRow& row : kRows) {
    const Timing timing = view.time_blend(row.kernel);
    if (rows.empty()) naive_ms = timing.median_ms;
    rows.push_back(show_row(row, view, naive_ms, timing));
    file.set("rows", rows);
  }
  if (view.is_on_gpu()) {
    std::printf(
        "\nOccupancy: warps resident on a multiprocessor (SM), of the most that it takes. Theoretical: by the "
        "CUDA occupancy calculator, with what limits it.\nAchieved: measured in a launch, over the time in "
        "which an SM has a block. SMs busy: that time, mean of all SMs relative to the busiest.\n");
  }
  return 0;
}

}  // namespace b3dgs
