// b3dgs bench step: times the stages of whole training steps on a scene, with the unmodified Trainer.
#include <algorithm>
#include <cstdio>
#include <limits>
#include <numeric>

#include "app/bench/bench_report.h"
#include "app/common/commands.h"
#include "app/common/stop_request.h"
#include "app/common/torch/progress.h"
#include "app/train/train_plan.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "raster/stages.h"
#include "train/checkpoint/checkpoint.h"
#include "train/device.h"
#include "train/scene_limits.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

struct BenchStepOptions {
  int steps = 100;
  int warmup = 10;
  std::string checkpoint;
  std::string json;
};

template <class Visitor>
void visit_fields(BenchStepOptions& c, Visitor&& field) {
  field(Option{"steps"}, c.steps, InRange{1, 100000},
        "number of timed training steps; the median of each stage is shown");
  field(Option{"warmup"}, c.warmup, InRange{0, 100000}, "number of steps before them that are not timed");
  field(Option{"checkpoint"}, c.checkpoint, Any{},
        "start from this checkpoint, with its options, instead of the scene's points");
  field(Option{"json"}, c.json, Any{}, "also write all numbers to this new file");
}

/// Times after the warm-up.
struct StepTimes {
  std::vector<StageTimes> steps, rounds;
};

/// Prints the table of stages, and returns it as JSON.
Json show_stages(const std::vector<StageTimes>& steps) {
  std::vector<double> wall_ms, host_ms;
  for (const StageTimes& step : steps) {
    wall_ms.push_back(step.wall_ms);
    host_ms.push_back(step.host_ms());
  }
  const double total_ms = std::accumulate(wall_ms.begin(), wall_ms.end(), 0.0);
  Json rows = Json::array();
  const auto add = [&](const char* name, const char* text, const std::vector<double>& ms) {
    if (ms.empty()) return;
    const double share = std::accumulate(ms.begin(), ms.end(), 0.0) / total_ms;
    print_timing(text, summarize(ms));
    std::printf(" %6.1f%%\n", 100 * share);
    rows.push_back(to_json(summarize(ms), {{"stage", name}}));
    rows.back()["share"] = share;
  };
  std::printf("\n%-16s %10s %23s %7s\n", "stage", "median ms", "min .. max", "share");
  for (std::size_t i = 0; i < kStageCount; ++i) {
    std::vector<double> ms;
    for (const StageTimes& step : steps) {
      if (step.ms[i]) ms.push_back(*step.ms[i]);
    }
    add(kStageNames[i], kStageNames[i], ms);
  }
  add("host", "remaining CPU", host_ms);
  add("step", "step", wall_ms);
  return rows;
}

/// `header` is that of --checkpoint.
TrainConfig make_config(const CommandLine& line, const BenchStepOptions& options, const nlohmann::ordered_json& header,
                        StatusLine& status) {
  GivenOptions given = given_options(line, /*config_file=*/"");
  given.erase("iterations");  // ignored, so it scales no schedule
  TrainConfig config;
  if (options.checkpoint.empty()) {
    config = resolve_options(given).config;
  } else {
    config = config_of_checkpoint(header, options.checkpoint);
    for (const std::string& text : apply_at_resume(config, given)) status.warn(text);
  }
  if (config.source_path.empty()) input_error("missing argument: SOURCE_PATH; usage: b3dgs bench step SOURCE_PATH");
  config.iterations = std::numeric_limits<int>::max();
  config.device = device_name(choose_device(config.device));
  return config;
}

/// Runs up to n steps, fewer after a stop signal, and waits for the device. Returns the mean wall-clock time per step,
/// ms.
double run_steps(Trainer& trainer, int n) {
  const double start_s = steady_seconds();
  int done = 0;
  for (; done < n && stop_signal() == 0; ++done) trainer.step();
  trainer.wait();
  return 1000 * (steady_seconds() - start_s) / std::max(1, done);
}

/// Prints all results and writes them to `file`.
void report_steps(const StepTimes& times, const TrainConfig& config, const Trainer& trainer, const Scene& scene,
                  double wall_ms, BenchFile& file) {
  double n_pixels = 0;  // pixels of a view, on average
  for (const View& view : scene.train) n_pixels += static_cast<double>(view.camera.width) * view.camera.height;
  n_pixels /= static_cast<double>(scene.train.size());
  std::printf("%s: %s Gaussians, %.2f Mpixel, %s, SH degree %d; %zu steps\n%s\n", config.source_path.c_str(),
              format_count(trainer.n_gaussians()).c_str(), 1e-6 * n_pixels, config.kernel.c_str(), trainer.sh_degree(),
              times.steps.size(), describe_device(choose_device(config.device)).c_str());
  file.set("stages", show_stages(times.steps));
  std::printf("%-16s %10.3f  per step, including density control and time between steps\n", "wall clock", wall_ms);
  file.set("wall_ms", wall_ms);
  if (!times.rounds.empty()) {
    std::vector<double> ms;
    for (const StageTimes& round : times.rounds) ms.push_back(round.wall_ms);
    print_timing("density control", summarize(ms));
    std::printf("  %zu rounds\n", ms.size());
    file.set("density_rounds", to_json(summarize(ms), {{"count", ms.size()}}));
  }
  file.set("steps", times.steps.size());
  file.set("n_gaussians", trainer.n_gaussians());
  file.set("n_pixels", n_pixels);
  file.set("sh_degree", trainer.sh_degree());
  file.set("device", config.device);
  file.set("config", config_to_json(config));
}

}  // namespace

int run_bench_step(const std::vector<std::string>& words) {
  BenchStepOptions options;
  CommandLine line("bench step", "Time whole training steps by stage. No model is written.",
                   "b3dgs bench step scenes/garden --steps 200");
  line.add(options, "Benchmark");
  line.add(resolve_options().config, "Training", {"source_path"},
           {"model_path", "iterations", "max_epochs", "test_iterations", "save_iterations", "checkpoint_iterations"});
  if (!line.parse(words)) return 0;
  BenchFile file(options.json);
  StatusLine status = StatusLine::for_stderr(false);
  nlohmann::ordered_json header;
  if (!options.checkpoint.empty()) header = read_checkpoint_header(options.checkpoint);
  const TrainConfig config = make_config(line, options, header, status);
  set_compute_threads(config.threads);

  SceneOptions how = scene_options(config);
  if (!options.checkpoint.empty()) how.frame = checkpoint_frame(header, options.checkpoint);
  const Scene scene = open_scene(how, status);
  StepTimes times;
  TrainHooks hooks = hooks_for(status);
  hooks.on_stage_times = [&, n_warmup = options.warmup](const StageTimes& known) mutable {
    if (known.kind == StageTimes::Kind::kDensityRound) {
      if (!times.steps.empty()) times.rounds.push_back(known);
    } else if (n_warmup > 0) {
      --n_warmup;
    } else {
      times.steps.push_back(known);
    }
  };
  Trainer trainer(finalize(config, scene), scene, ModelFolder(""), hooks);
  status.clear();
  if (!options.checkpoint.empty()) trainer.resume(options.checkpoint);

  catch_stop_signals();
  if (options.warmup > 0) run_steps(trainer, options.warmup);
  const double wall_ms = run_steps(trainer, options.steps);
  if (times.steps.empty()) return 128 + stop_signal();  // interrupted before the first timed step
  report_steps(times, config, trainer, scene, wall_ms, file);
  return stop_signal() == 0 ? 0 : 128 + stop_signal();
}

}  // namespace b3dgs
