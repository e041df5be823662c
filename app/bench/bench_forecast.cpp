// b3dgs bench forecast: how long each preset trains a scene on this machine, and how much memory and disk it takes. The
// schedules are shortened to a few hundred steps, with all of their growth, and the times of these steps scaled up.
#include <sys/resource.h>

#include <algorithm>
#include <cstdio>

#include "app/bench/bench_report.h"
#include "app/common/commands.h"
#include "app/common/stop_request.h"
#include "app/common/torch/progress.h"
#include "app/train/train_plan.h"
#include "config/option_layers.h"
#include "config/presets.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/parallel.h"
#include "core/text.h"
#include "train/device.h"
#include "train/scene_limits.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

struct ForecastOptions {
  int steps = 300;
  std::string json;
};

template <class Visitor>
void visit_fields(ForecastOptions& c, Visitor&& field) {
  field(Option{"steps"}.common(), c.steps, InRange{50, 100000}, "steps to run for each preset; more are more accurate");
  field(Option{"json"}, c.json, Any{}, "also write all numbers to this new file");
}

struct Forecast {
  std::string preset;
  int iterations = 0;
  std::int64_t n_gaussians = 0;  // at the end of the short training
  double train_s = 0;
  std::int64_t gpu_bytes = 0, host_bytes = 0;  // largest so far
};

std::int64_t peak_host_bytes() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return std::int64_t{usage.ru_maxrss} * 1024;
}

/// Trains with the shortened schedule, and scales its times to the whole one. A step takes about the same time at the
/// same part of either schedule. Both have the same rounds of density control.
Forecast forecast(const GivenOptions& given, const ForecastOptions& options, const Scene& scene, StatusLine& status) {
  TrainPlan whole;
  whole.layers = resolve_options(given);
  whole.config = whole.layers->config;
  whole.fixed = given;
  Forecast result{given.at("preset"), fit_to_scene(whole, scene).config.options.iterations};
  GivenOptions short_given = given;
  short_given["iterations"] = std::min(options.steps, result.iterations);
  const FinalConfig config = finalize(resolve_options(short_given).config, scene);
  double rounds_s = 0;
  TrainHooks hooks = hooks_for(status);
  hooks.memory = make_memory_source(config.device, config.options.gpu_memory_gb);
  hooks.memory->release_unused();  // of the preset before
  hooks.on_stage_times = [&](const StageTimes& times) {
    if (times.kind == StageTimes::Kind::kDensityRound) rounds_s += 1e-3 * times.wall_ms;
  };
  Trainer trainer(config, scene, ModelFolder(""), hooks);
  trainer.step();  // also makes the initial Gaussians
  trainer.wait();
  const double start_s = steady_seconds();
  const ProgressFn progress = show_loading(status);
  int done = 1;
  for (; done < config.options.iterations && stop_signal() == 0; done += config.options.batch) {
    trainer.step();
    progress("measuring " + result.preset + ", step", static_cast<std::size_t>(done), config.options.iterations);
  }
  trainer.wait();
  const double steps_s = steady_seconds() - start_s - rounds_s;
  result.train_s = rounds_s + steps_s * result.iterations / std::max(1, done - 1);
  result.n_gaussians = trainer.n_gaussians();
  result.gpu_bytes = hooks.memory->use().peak_reserved;
  result.host_bytes = peak_host_bytes();
  return result;
}

}  // namespace

int run_bench_forecast(const std::vector<std::string>& words) {
  ForecastOptions options;
  CommandLine line("bench forecast",
                   "Say how long the presets train a scene on this machine, how much memory they take, and how large "
                   "their files become. Runs a short training of each, and writes no model.",
                   "b3dgs bench forecast scenes/garden");
  line.add(options, "Forecast");
  line.add(resolve_options().config, "Training", {"source_path"},
           {"model_path", "preset", "strategy", "iterations", "max_epochs", "test_iterations", "save_iterations",
            "checkpoint_iterations"});
  if (!line.parse(words)) return 0;
  GivenOptions given = given_options(line, /*config_file=*/"");
  TrainConfig config = resolve_options(given).config;
  if (config.source_path.empty()) input_error("missing argument: SOURCE_PATH; usage: b3dgs bench forecast SCENE");
  BenchFile file(options.json);
  StatusLine status = StatusLine::for_stderr(false);
  const torch::Device device = choose_device(config.device);
  set_compute_threads(config.threads);
  const Scene scene = open_scene(scene_options(config), status);
  catch_stop_signals();

  status.clear();
  std::printf("%s, %s\n%-8s %10s %12s %10s %12s %12s %10s %12s\n", config.source_path.c_str(),
              describe_device(device).c_str(), "preset", "iterations", "Gaussians", "time", "GPU memory", "host memory",
              "PLY", "checkpoints");
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const OptionRow& preset : presets()) {
    if (preset.values.empty()) continue;  // inria, whose growth no plan limits
    given["preset"] = preset.name;
    const Forecast found = forecast(given, options, scene, status);
    if (stop_signal() != 0) return 128 + stop_signal();
    constexpr std::int64_t kCheckpointBytes = 720;  // of a Gaussian: parameters, two moments, and statistics
    const std::int64_t ply = ply_bytes(found.n_gaussians, config.sh_degree);
    const std::int64_t checkpoints = config.keep_checkpoints * kCheckpointBytes * found.n_gaussians;
    status.clear();
    std::printf("%-8s %10s %12s %10s %12s %12s %10s %12s\n", preset.name, format_count(found.iterations).c_str(),
                format_count(found.n_gaussians).c_str(), format_duration(found.train_s).c_str(),
                device.is_cuda() ? format_bytes(found.gpu_bytes).c_str() : "-", format_bytes(found.host_bytes).c_str(),
                format_bytes(ply).c_str(), format_bytes(checkpoints).c_str());
    rows.push_back({{"preset", preset.name},
                    {"iterations", found.iterations},
                    {"n_gaussians", found.n_gaussians},
                    {"train_s", found.train_s},
                    {"gpu_bytes", found.gpu_bytes},
                    {"host_bytes", found.host_bytes},
                    {"ply_bytes", ply},
                    {"checkpoint_bytes", checkpoints}});
    file.set("presets", rows);
  }
  return 0;
}

}  // namespace b3dgs
