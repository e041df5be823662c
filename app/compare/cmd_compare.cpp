// b3dgs compare: trains one scene with several configurations in turns, and compares their time and quality.
#include <algorithm>
#include <iostream>

#include "app/common/commands.h"
#include "app/common/stop_request.h"
#include "app/common/torch/machine.h"
#include "app/common/torch/model.h"
#include "app/common/torch/progress.h"
#include "app/compare/comparison.h"
#include "app/compare/interleaved_training.h"
#include "app/train/replaced_model.h"
#include "config/option_layers.h"
#include "config/original_options.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "scene/view_image.h"
#include "train/device.h"
#include "train/scene_limits.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct CompareOptions {
  // Includes the kernels without load balancing, as the baseline for adaptive, so that the benefit of balancing is
  // known.
  std::vector<std::string> configs{"naive", "sub-tile", "adaptive"};
  std::vector<std::int64_t> seeds;
  bool noise = false;
  int chunk = 100;
  std::string config;
  bool resume = false;
  bool overwrite = false;
  bool quiet = false;
};

template <class Visitor>
void visit_fields(CompareOptions& c, Visitor&& field) {
  field(Option{"configs"}.common(), c.configs, Any{},
        "paper, or several [NAME:]PART+PART...; PART: kernel, naive-kernels or option=value");
  field(Option{"seeds"}.common(), c.seeds, AtLeast{0}, "train with each of these seeds, instead of --seed");
  field(Option{"noise"}.common(), c.noise, Any{}, "train the first configuration twice, to show the measurement noise");
  field(Option{"chunk"}, c.chunk, AtLeast{1}, "iterations per turn; the configurations take turns");
  field(Option{"config"}, c.config, Any{}, "JSON file with option names as keys; the command line overrides it");
  field(Option{"resume"}.common(), c.resume, Any{}, "resume the comparison in the output folder (-m)");
  field(Option{"overwrite"}, c.overwrite, Any{}, "replace an existing comparison in the output folder");
  field(Option{"quiet"}, c.quiet, Any{}, "print results and warnings only");
}

/// Holds out test views unless --no_eval is given, because times should be compared at equal quality.
TrainConfig default_config() {
  TrainConfig config = resolve_options().config;
  config.eval = true;
  return config;
}

[[noreturn]] void fail_without_scene() {
  input_error("missing argument: SOURCE_PATH; usage: b3dgs compare SOURCE_PATH");
}

std::string output_folder(const CommandLine& line) {
  const std::string model = line.given().value("model_path", ""), source = line.given().value("source_path", "");
  if (!model.empty()) return model;
  if (source.empty()) fail_without_scene();
  return (fs::path("output") / (scene_name(source) + "-compare")).string();
}

/// Joins the configurations for parse_configurations().
std::string joined(const std::vector<std::string>& configs) {
  return list_text(configs, ",");
}

/// @throws InputError if given options differ from those of the comparison to resume
void refuse_changes(const CommandLine& line, const CompareOptions& options, const ComparisonPlan& plan,
                    const TrainConfig& planned) {
  const auto refuse_if = [](bool is_changed, const std::string& option, const std::string& was) {
    if (is_changed) input_error("--resume cannot change --", option, " (", was, "); use another folder (-m)");
  };
  refuse_if(line.was_given("configs") && joined(options.configs) != plan.configs, "configs", plan.configs);
  refuse_if(line.was_given("seed") || plan.base.seed != planned.seed, "seed",
            "the comparison has the seeds " + list_text(plan.seeds) + "; --seeds adds seeds");
  refuse_if(plan.base.preset != planned.preset, "preset", planned.preset);
  refuse_if(line.was_given("noise") && options.noise != plan.has_repetition, "noise",
            std::string("the comparison was started ") + (plan.has_repetition ? "with" : "without") + " it");
}

/// Returns the stored plan with --resume, otherwise a plan from the command line.
ComparisonPlan make_plan(const CommandLine& line, const CompareOptions& options) {
  if (options.resume && options.overwrite) {
    input_error("--resume and --overwrite exclude each other: one continues the comparison in the output folder, the ",
                "other replaces it");
  }
  if (line.was_given("seed") && line.was_given("seeds")) {
    input_error("--seed and --seeds exclude each other; name all seeds with --seeds");
  }
  const std::string root = output_folder(line);
  ComparisonPlan plan;
  if (options.resume) plan = read_plan(root);
  const TrainConfig planned = plan.base;
  GivenOptions& given = plan.given;
  given.update(given_options(line, options.config));
  if (!options.resume) given.emplace("eval", default_config().eval);
  plan.base = resolve_options(given).config;
  plan.set_photographs(plan.photographs);  // photographs of the comparison to resume
  plan.base.model_path = root;
  if (plan.base.source_path.empty()) fail_without_scene();
  make_absolute(plan.base.source_path);
  make_absolute(plan.base.init_ply);
  given["source_path"] = plan.base.source_path;
  given["init_ply"] = plan.base.init_ply;

  if (options.resume) {
    refuse_changes(line, options, plan, planned);
  } else {
    plan.configs = joined(options.configs);
    plan.has_repetition = options.noise;
  }
  if (!options.resume || line.was_given("chunk")) plan.chunk = options.chunk;
  if (line.was_given("seeds")) plan.seeds = options.seeds;
  if (plan.seeds.empty()) plan.seeds = {plan.base.seed};
  for (const std::int64_t seed : plan.seeds) {
    if (std::count(plan.seeds.begin(), plan.seeds.end(), seed) > 1) input_error("--seeds: ", seed, " occurs twice");
  }
  // All share one scene, and anti-aliasing needs pinholes (scene_options()).
  for (const Configuration& own : plan.configurations()) {
    if (own.config.antialiasing && own.config.lenses == "auto") given["lenses"] = plan.base.lenses = "undistort";
  }
  return plan;
}

std::vector<ModelFolder> model_folders(const ComparisonPlan& plan) {
  std::vector<ModelFolder> folders;
  for (const Configuration& configuration : plan.configurations()) {
    for (const std::int64_t seed : plan.seeds) folders.push_back(plan.folder(configuration, seed));
  }
  return folders;
}

/// Prevents accidental replacement of a comparison, and the use of models of other trainings as part of it.
void guard_comparison(const ComparisonPlan& plan, const CompareOptions& options) {
  if (ModelFolder(plan.root()).holds_model()) {
    input_error(plan.root().string(),
                ": holds a model of b3dgs train; choose another folder for the comparison with -m");
  }
  if (options.resume || options.overwrite) return;
  if (holds_comparison(plan.root())) {
    input_error(plan.root().string(),
                ": already holds a comparison; resume it with --resume, replace it with --overwrite, or choose another "
                "folder with -m");
  }
  for (const ModelFolder& folder : model_folders(plan)) {
    if (!folder.holds_model()) continue;
    input_error(folder.root().string(), ": already holds a model that belongs to no comparison; replace it with ",
                "--overwrite, or choose another folder with -m");
  }
}

/// The default number of iterations is meant for a GPU.
void suggest_fewer_iterations(const ComparisonPlan& plan, const torch::Device& device, StatusLine& status) {
  constexpr int kFewer = 2000;
  if (!device.is_cpu() || plan.given.contains("iterations") || plan.longest() <= kFewer) return;
  status.print(detail::concat("training on a CPU: ", format_count(plan.longest()), " iterations of each of ",
                              plan.configurations().size(), " configurations take long; --iterations ", kFewer,
                              " gives a first comparison sooner"));
}

bool is_trained(const ComparisonPlan& plan, std::int64_t seed) {
  for (const Configuration& configuration : plan.configurations()) {
    const std::vector<int> saved = plan.folder(configuration, seed).ply_iterations();
    if (std::count(saved.begin(), saved.end(), configuration.config.iterations) == 0) return false;
  }
  return true;
}

/// Moves the runs and results of earlier comparisons to replaced/ in their folders.
void put_comparison_aside(const std::vector<ComparisonPlan>& replaced, StatusLine& status) {
  for (const ComparisonPlan& old : replaced) {
    for (const ModelFolder& folder : model_folders(old)) require_movable(folder);
  }
  for (const ComparisonPlan& old : replaced) {
    for (const ModelFolder& folder : model_folders(old)) put_model_aside(folder, status);
  }
  const fs::path root = replaced.front().root();
  put_aside(root, {root / kComparisonFile, root / kComparisonReport});
}

/// Removes the files kept by put_comparison_aside(), also those of configurations that are no longer compared.
void drop_replaced_comparison(const fs::path& root) {
  drop_replaced_model(root);
  std::error_code error;  // ignored: unreadable folders have nothing of this program
  for (const fs::directory_entry& configuration : fs::directory_iterator(root, error)) {
    if (!configuration.is_directory(error) || configuration.is_symlink(error)) continue;
    for (const fs::directory_entry& run : fs::directory_iterator(configuration, error)) {
      const bool is_run = run.path().filename().string().rfind("seed_", 0) == 0;
      if (is_run && run.is_directory(error) && !run.is_symlink(error)) drop_replaced_model(run.path());
    }
  }
}

/// Moves the runs of `replaced` aside and trains all unfinished runs. Returns false if a signal stopped it.
bool train_all(ComparisonPlan& plan, const std::vector<ComparisonPlan>& replaced, const torch::Device& device,
               const CompareOptions& options, StatusLine& status) {
  const auto is_open = [&](std::int64_t seed) { return !is_trained(plan, seed); };
  if (replaced.empty() && std::none_of(plan.seeds.begin(), plan.seeds.end(), is_open)) return true;
  const double start_s = steady_seconds();
  SceneOptions scene_options = b3dgs::scene_options(plan.base);
  // One per configuration and one for evaluations, which run one at a time.
  scene_options.n_readers = static_cast<int>(plan.configurations().size()) + 1;
  const Scene scene = open_scene(scene_options, status);
  if (plan.photographs.n != 0 && plan.photographs.n != scene.train.size()) {
    input_error(plan.base.source_path, ": ", scene.train.size(), " photographs for training, but the comparison in ",
                plan.root().string(), " began with ", plan.photographs.n,
                "; resume it with the same photographs and options, or begin again with --overwrite");
  }
  plan.set_photographs(training_photographs(scene));
  if (!options.resume && !options.quiet) suggest_fewer_iterations(plan, device, status);
  hold_images(scene.train, show_loading(status));  // shared by all configurations and seeds
  const double reading_s = steady_seconds() - start_s;
  plan.reading_s += reading_s;
  if (!options.quiet) {
    for (const std::string& text : scene.summary) std::cout << text << "\n";
    std::cout << describe_device(device) << std::endl;
  }
  // Only after the scene has been read and all folders exist, so that nothing is moved if one of them fails.
  for (const ModelFolder& folder : model_folders(plan)) create_folder(folder.root());
  if (!replaced.empty()) put_comparison_aside(replaced, status);
  write_plan(plan);
  const nlohmann::ordered_json machine = describe_machine(device);
  warm_up(plan, scene);
  catch_stop_signals();
  for (const std::int64_t seed : plan.seeds) {
    if (!is_open(seed)) continue;
    if (!train_in_turns(plan, seed, scene, reading_s, machine, status)) return false;
  }
  return true;
}

}  // namespace

int run_compare(const std::vector<std::string>& words) {
  CommandLine line(
      "compare",
      "Train a scene with several configurations, taking turns, and compare time and quality. "
      "Writes compare.json, report.html and the models. All models of a seed are in memory at the same time. The "
      "first of --configs is the baseline; `naive-kernels` stands for the kernels of the original 3DGS "
      "(--kernel naive --culling square), preset=NAME for a preset, and `paper` for the comparison of the Balanced "
      "3DGS paper: naive-kernels, and the same with --kernel published.",
      "b3dgs compare scenes/garden --configs inria:preset=inria,fast:preset=fast,quality:preset=quality");
  CompareOptions options;
  line.add(options, "Comparison");
  line.add(default_config(), "Training", {"source_path"});
  add_original_options(line, OriginalScript::kTrain);
  line.set_help("model_path", "output folder (default output/SCENE-compare)");
  if (!line.parse(words)) return 0;

  StatusLine status = StatusLine::for_stderr(options.quiet);
  for (const std::string& text : describe_original_options(line.given(), OriginalScript::kTrain)) status.warn(text);
  ComparisonPlan plan = make_plan(line, options);
  const torch::Device device = choose_device(plan.base.device);
  plan.base.device = device_name(device);
  // Runs before photographs are read and anything is written.
  for (const Configuration& configuration : plan.configurations()) check_options(configuration.config, device);
  const FolderLock lock(plan.root());
  guard_comparison(plan, options);
  set_compute_threads(plan.base.threads);
  std::vector<ComparisonPlan> replaced;
  if (options.overwrite) replaced.push_back(plan);  // its folders may have models outside any comparison
  if (options.overwrite && holds_comparison(plan.root())) {
    try {
      replaced.push_back(read_plan(plan.root()));
    } catch (const InputError&) {  // damaged: the file is moved aside when it is replaced
    }
  }

  const bool is_complete = train_all(plan, replaced, device, options, status);
  const Comparison comparison = load_comparison(plan);
  write_comparison(comparison);
  std::cout << describe_comparison(comparison);
  std::cout << "written: " << (plan.root() / "report.html").string() << ", compare.json" << std::endl;
  if (is_complete) {
    drop_replaced_comparison(plan.root());
    return 0;
  }
  std::cout << "stopped by a signal; resume with: " << resume_command(plan) << "\n";
  return 128 + stop_signal();
}

}  // namespace b3dgs
