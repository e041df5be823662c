// b3dgs compare: trains one scene with several configurations, turn by turn, and says what each takes and gives.
#include <algorithm>
#include <iostream>

#include "app/commands.h"
#include "app/compare/interleaved_training.h"
#include "app/machine/machine.h"
#include "app/model.h"
#include "app/terminal/progress.h"
#include "app/train_setup.h"
#include "compare/comparison.h"
#include "core/check.h"
#include "core/command_line.h"
#include "core/files/folder_lock.h"
#include "scene/view_image.h"
#include "train/device.h"
#include "train/threads.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct CompareOptions {
  std::string configs = "naive,shared-memory,adaptive";  // all unbalanced kernels, or balancing cannot be told apart
  std::vector<std::int64_t> seeds;
  bool noise = false;
  int chunk = 100;
  std::string config;
  bool resume = false;
  bool overwrite = false;
  bool quiet = false;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, CompareOptions>> visit_fields(Config& c, Visitor&& field) {
  field(
      Option{"configs"}, c.configs, Any{},
      "what to compare, the first being the baseline: entries between commas, each [NAME:]PART+PART..., a part being a "
      "--kernel, original (naive, per-pixel backward pass, square culling, 16x16 tiles: what comes nearest to the "
      "original trainer) or option=value of any training option below, as in "
      "naive,adaptive,shared-memory+culling=square");
  field(Option{"seeds"}, c.seeds, AtLeast{0}, "train with each of these, one after the other, instead of --seed");
  field(Option{"noise"}, c.noise, Any{},
        "train the first configuration twice, and show beside every difference how much it differs from itself");
  field(Option{"chunk"}, c.chunk, AtLeast{1},
        "iterations of a turn: the configurations take turns, so that drift of the "
        "machine hits all alike");
  field(Option{"config"}, c.config, Any{}, "JSON file with names of training options as keys; options given here win");
  field(Option{"resume"}, c.resume, Any{},
        "continue the comparison in the output folder (-m), with its options unless others are given");
  field(Option{"overwrite"}, c.overwrite, Any{}, "replace the comparison that the output folder holds");
  field(Option{"quiet"}, c.quiet, Any{}, "show no progress, no messages and no summary of the scene");
}

/// Views are held out unless --no_eval says otherwise: a comparison of times is worth little without quality.
TrainConfig default_config() {
  TrainConfig config;
  config.eval = true;
  return config;
}

std::string output_folder(const CommandLine& line) {
  TrainConfig given;
  line.apply(given);
  if (!given.model_path.empty()) return given.model_path;
  if (given.source_path.empty()) input_error("command line: which scene? b3dgs compare SCENE");
  return (fs::path("output") / (scene_name(given.source_path) + "-compare")).string();
}

std::string listed(const std::vector<std::int64_t>& seeds) {
  std::string text;
  for (const std::int64_t seed : seeds) text += (text.empty() ? "" : " ") + std::to_string(seed);
  return text;
}

/// The plan of --resume, or one of the command line.
ComparisonPlan make_plan(const CommandLine& line, const CompareOptions& options) {
  const std::string root = output_folder(line);
  ComparisonPlan plan;
  plan.base = default_config();
  if (options.resume) plan = read_plan(root);
  const std::int64_t planned_seed = plan.base.seed;
  if (!options.config.empty()) apply_config_file(plan.base, options.config);
  line.apply(plan.base);
  // A comparison shows the candidates' times over the whole training, unless the command line says otherwise.
  if (!options.resume && !line.was_given("kernel_times_interval") && plan.base.kernel_times_interval == 0) {
    plan.base.kernel_times_interval = plan.base.stats_interval;
  }
  plan.base.model_path = root;
  if (plan.base.source_path.empty()) input_error("command line: which scene? b3dgs compare SCENE");
  make_absolute(plan.base.source_path);
  make_absolute(plan.base.init_ply);

  if (options.resume && line.was_given("configs") && options.configs != plan.configs) {
    input_error("command line: --resume continues --configs ", plan.configs, "; compare others in another folder (-m)");
  }
  if (options.resume && options.overwrite) {
    input_error("command line: --resume goes on with the comparison that --overwrite would replace; give one of them");
  }
  if (options.resume && (line.was_given("seed") || plan.base.seed != planned_seed)) {
    input_error("command line: --resume continues the seeds ", listed(plan.seeds), ", and --seed would change none; ",
                "add seeds with --seeds, or compare in another folder (-m)");
  }
  if (options.resume && line.was_given("noise") && options.noise != plan.has_repetition) {
    input_error("command line: --resume continues ", plan.has_repetition ? "with" : "without",
                " --noise; compare otherwise in another folder (-m)");
  }
  if (!options.resume) plan.configs = options.configs;
  if (!options.resume) plan.has_repetition = options.noise;
  if (!options.resume || line.was_given("chunk")) plan.chunk = options.chunk;
  if (line.was_given("seeds")) plan.seeds = options.seeds;
  if (plan.seeds.empty()) plan.seeds = {plan.base.seed};
  for (std::size_t i = 0; i < plan.seeds.size(); ++i) {
    if (std::find(plan.seeds.begin(), plan.seeds.begin() + static_cast<std::ptrdiff_t>(i), plan.seeds[i]) !=
        plan.seeds.begin() + static_cast<std::ptrdiff_t>(i)) {
      input_error("command line: --seeds: ", plan.seeds[i], " occurs twice");
    }
  }
  return plan;
}

/// A comparison is hours of work: it is not replaced by accident. Nor are models of other trainings taken for its own.
void guard_comparison(const ComparisonPlan& plan, const CompareOptions& options) {
  if (options.resume || options.overwrite) return;
  if (holds_comparison(plan.root())) {
    input_error(plan.root().string(),
                ": already holds a comparison; continue it with --resume, replace it with --overwrite, or name another "
                "folder with -m");
  }
  for (const Configuration& configuration : plan.configurations()) {
    for (const std::int64_t seed : plan.seeds) {
      const ModelFolder folder = plan.folder(configuration, seed);
      if (!folder.holds_model()) continue;
      input_error(folder.root().string(), ": already holds a model, and ", plan.root().string(),
                  " no comparison that it is of; replace it with --overwrite, or name another folder with -m");
    }
  }
}

void remove_runs(const ComparisonPlan& plan) {
  for (const Configuration& configuration : plan.configurations()) {
    for (const std::int64_t seed : plan.seeds) remove_model(plan.folder(configuration, seed));
  }
}

bool is_trained(const ComparisonPlan& plan, std::int64_t seed) {
  for (const Configuration& configuration : plan.configurations()) {
    const ModelFolder folder = plan.folder(configuration, seed);
    const std::vector<int> saved = folder.ply_iterations();
    if (std::find(saved.begin(), saved.end(), plan.base.iterations) == saved.end()) return false;
  }
  return true;
}

/// Trains what is left to train, after taking away the runs of `replaced`. False if a signal stopped it.
bool train_all(ComparisonPlan& plan, const std::vector<ComparisonPlan>& replaced, const torch::Device& device,
               const CompareOptions& options, StatusLine& status) {
  const auto is_open = [&](std::int64_t seed) { return !is_trained(plan, seed); };
  if (replaced.empty() && std::none_of(plan.seeds.begin(), plan.seeds.end(), is_open)) return true;
  const double start_s = steady_seconds();
  SceneOptions scene_options = b3dgs::scene_options(plan.base);
  scene_options.n_readers = static_cast<int>(plan.configurations().size()) + 1;  // one evaluates at a time
  const Scene scene = open_scene(scene_options, status);
  hold_images(scene.train, show_loading(status));  // every configuration of every seed takes them from there
  const double reading_s = steady_seconds() - start_s;
  plan.reading_s += reading_s;
  if (!options.quiet) {
    for (const std::string& text : scene.summary) std::cout << text << "\n";
    std::cout << describe_device(device) << std::endl;
  }
  // Only now: a scene that cannot be read must not cost the models that are there.
  for (const ComparisonPlan& old : replaced) remove_runs(old);
  write_plan(plan);
  const nlohmann::ordered_json machine = describe_machine(device);
  const double loading_ms = warm_up(plan, scene);
  if (plan.loading_ms == 0) plan.loading_ms = loading_ms;  // of one fresh process, however often it was resumed
  write_plan(plan);
  catch_stop_signals();
  for (const std::int64_t seed : plan.seeds) {
    if (!is_open(seed)) continue;
    if (!InterleavedTraining(plan, seed, scene, status).run(reading_s, machine)) return false;
  }
  return true;
}

}  // namespace

int run_compare(const std::vector<std::string>& words) {
  CommandLine line("compare",
                   "Trains a COLMAP scene with several configurations in turns, and compares time and quality: "
                   "b3dgs compare SCENE [-m OUTPUT]. Writes compare.json, report.html and the models. All models of a "
                   "seed are in memory at the same time.");
  CompareOptions options;
  line.add(options, "Comparison");
  line.add(default_config(), "Training", {"source_path"});
  if (!line.parse(words)) return 0;
  line.apply(options);

  ComparisonPlan plan = make_plan(line, options);
  const torch::Device device = choose_device(plan.base.device);
  plan.base.device = device_name(device);
  plan.configurations();  // their errors before anything is written
  const EmptyFolderGuard guard(plan.root());
  const FolderLock lock(plan.root());
  guard_comparison(plan, options);
  set_compute_threads(plan.base.threads);
  std::vector<ComparisonPlan> replaced;
  if (options.overwrite) replaced.push_back(plan);  // its folders may hold models that no comparison names
  if (options.overwrite && holds_comparison(plan.root())) replaced.push_back(read_plan(plan.root()));

  StatusLine status = StatusLine::for_stderr(options.quiet);
  const bool is_complete = train_all(plan, replaced, device, options, status);
  const Comparison comparison = load_comparison(plan);
  write_comparison(comparison);
  print_comparison(comparison);
  std::cout << "written: " << (plan.root() / "report.html").string() << ", compare.json" << std::endl;
  if (is_complete) return 0;
  std::cout << "stopped by a signal; continue with b3dgs compare --resume -m " << plan.root().string() << "\n";
  return 128 + stop_signal();
}

}  // namespace b3dgs
