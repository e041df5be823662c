#include "app/train_plan.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "app/model.h"
#include "app/train_setup.h"
#include "compare/comparison.h"
#include "core/check.h"
#include "model/checkpoint/checkpoint_header.h"
#include "model/training_id.h"
#include "train/checkpoint/checkpoint.h"
#include "train/checkpoint/checkpoint_file.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::string default_model_path(const std::string& source_path) {
  return (fs::path("output") / scene_name(source_path)).string();
}

/// The newest valid checkpoint of a model folder; empty if it has no checkpoints. @throws InputError if all are damaged
fs::path newest_checkpoint(const ModelFolder& folder, StatusLine& status) {
  fs::path checkpoint = newest_valid_checkpoint(folder, [&](const std::string& message) { status.warn(message); });
  if (checkpoint.empty() && !folder.checkpoint_iterations().empty()) {
    input_error("all checkpoints are damaged: ", folder.root().string(),
                "; start again in another folder (-m), or in this one with --overwrite instead of --resume");
  }
  return checkpoint;
}

/// The checkpoint to resume; empty to start from the beginning. With --resume auto, sets config.model_path if empty.
fs::path find_checkpoint(TrainConfig& config, const TrainCommandOptions& options, StatusLine& status) {
  if (options.resume != "auto") {
    if (!fs::exists(options.resume)) {
      input_error("nothing to resume: ", options.resume, " not found (expected a checkpoint, a model folder, or auto)");
    }
    if (!fs::is_directory(options.resume)) return options.resume;
    const ModelFolder folder(options.resume);
    fs::path checkpoint = newest_checkpoint(folder, status);
    if (checkpoint.empty())
      input_error("no checkpoint found: ", options.resume, " (expected checkpoints/iteration_N.b3dgs)");
    return checkpoint;
  }
  if (config.model_path.empty() && config.source_path.empty()) {
    input_error("--resume auto needs the model folder (-m) or the scene (-s)");
  }
  if (config.model_path.empty()) config.model_path = default_model_path(config.source_path);
  const ModelFolder folder(config.model_path);
  fs::path checkpoint = newest_checkpoint(folder, status);
  if (!checkpoint.empty()) return checkpoint;
  if (config.source_path.empty() && !folder.has_config()) {
    input_error("nothing to resume: ", config.model_path, " (expected checkpoints/ or config.json); ",
                "start a training with b3dgs train SOURCE_PATH -m ", config.model_path);
  }
  status.print("no checkpoint to resume in " + config.model_path + ", starting from the beginning");
  return "";
}

/// The config stored in a checkpoint, with the folder that now contains the checkpoint as model folder.
TrainConfig config_of_checkpoint(const fs::path& checkpoint) {
  const nlohmann::ordered_json header = read_checkpoint_header(checkpoint);
  TrainConfig config;
  if (!header.contains("config"))
    input_error("not a training checkpoint: ", checkpoint.string(), " (expected a config in its header)");
  config_from_json(config, header["config"], checkpoint.string());
  config.device = TrainConfig{}.device;  // depends on the machine, not on the training
  const fs::path folder = fs::absolute(checkpoint).lexically_normal().parent_path();
  if (folder.filename() == "checkpoints") config.model_path = folder.parent_path().string();
  return config;
}

/// The options of a training that was interrupted before its first checkpoint.
TrainConfig config_of_folder(const std::string& model_path) {
  TrainConfig config = ModelFolder(model_path).read_config();
  config.device = TrainConfig{}.device;
  config.model_path = model_path;
  return config;
}

/// With several ranks, each draws a view of a step unless the user says otherwise.
void choose_batch(TrainConfig& config, const OptionLayers& layers, int n_ranks) {
  const bool is_chosen =
      layers.given.contains("batch") || layers.preset.contains("batch") || layers.strategy.contains("batch");
  if (n_ranks > 1 && !is_chosen) config.batch = std::min(n_ranks, kMaxBatch);
}

/// @throws InputError if --overwrite would remove a file or folder that the training reads
void check_inputs_are_elsewhere(const ModelFolder& folder, const TrainConfig& config) {
  const fs::path model = fs::weakly_canonical(folder.root());
  for (const auto& [option, value] : {std::pair{"-s", config.source_path}, std::pair{"--init_ply", config.init_ply},
                                      std::pair{"--images", config.images}, std::pair{"--masks", config.masks},
                                      std::pair{"--depths", config.depths}}) {
    if (value.empty()) continue;
    const fs::path path = fs::weakly_canonical(fs::path(config.source_path) / value).lexically_relative(model);
    if (const auto first = path.begin(); first != path.end() && (*first == "point_cloud" || *first == "report")) {
      input_error(option, " ", value, " is part of the model that --overwrite replaces; copy it elsewhere first");
    }
  }
}

}  // namespace

TrainPlan make_plan(const CommandLine& line, StatusLine& status, const TrainCommandOptions& options, int n_ranks) {
  TrainPlan plan;
  plan.options = options;
  TrainConfig& config = plan.config;
  if (options.resume == "auto" && options.overwrite) {
    input_error("--resume auto and --overwrite exclude each other: one continues the model in the output folder, the ",
                "other replaces it");
  }
  const GivenOptions given = given_options(line, options.config);
  plan.layers = resolve_options(given);
  config = plan.layers->config;
  if (!options.resume.empty()) plan.checkpoint = find_checkpoint(config, options, status);
  if (!plan.checkpoint.empty()) {
    const std::string named_folder = config.model_path;
    config = config_of_checkpoint(plan.checkpoint);
    apply_at_resume(config, given);
    if (!named_folder.empty()) config.model_path = named_folder;
    plan.layers.reset();
  } else if (options.resume == "auto" && config.source_path.empty()) {
    config = config_of_folder(config.model_path);
    apply_at_resume(config, given);
    plan.layers.reset();
  }
  if (plan.layers) choose_batch(config, *plan.layers, n_ranks);
  if (config.source_path.empty())
    input_error("missing argument: SOURCE_PATH; usage: b3dgs train SOURCE_PATH, or -s SOURCE_PATH");
  if (config.model_path.empty()) config.model_path = default_model_path(config.source_path);
  make_absolute(config.source_path);
  make_absolute(config.init_ply);
  plan.fixed = plan.layers ? given : config_to_json(config);
  return plan;
}

bool guard_model(const ModelFolder& folder, const TrainPlan& plan) {
  if (holds_comparison(folder.root())) {
    input_error("output folder holds a comparison: ", folder.root().string(), "; choose another folder with -m");
  }
  if (!plan.checkpoint.empty()) {
    const auto training_id = read_checkpoint_header(plan.checkpoint).value("training_id", "");
    if (!plan.options.overwrite) check_training_id(folder, plan.checkpoint, training_id);
    const bool is_replaced = !may_continue_in(folder, plan.checkpoint, training_id);
    if (plan.options.overwrite && !is_replaced && folder.holds_model()) {
      input_error("--overwrite has nothing to replace: ", folder.root().string(),
                  " holds the training that --resume continues; leave out one of them");
    }
    std::error_code error;
    if (is_replaced && fs::equivalent(plan.checkpoint.parent_path(), folder.checkpoint(0).parent_path(), error)) {
      input_error("checkpoint is in the folder of another training: ", plan.checkpoint.string(),
                  " (--overwrite would remove it, too); move it elsewhere first");
    }
    return is_replaced;
  }
  if (plan.options.overwrite) {
    // Otherwise there is nothing to replace: a folder report/, for example, is the user's.
    const bool is_replaced = folder.holds_model() || !folder.training_id().empty();
    if (is_replaced) check_inputs_are_elsewhere(folder, plan.config);
    return is_replaced;
  }
  if (!folder.holds_model()) return false;
  input_error("output folder already holds a model: ", folder.root().string(), "; ",
              folder.checkpoint_iterations().empty() ? "" : "resume it with --resume auto, ",
              "replace it with --overwrite, or choose another folder with -m");
}

void check_checkpoint(const fs::path& checkpoint, const TrainConfig& config) {
  if (checkpoint.empty()) return;
  const nlohmann::ordered_json header = read_checkpoint_header(checkpoint);
  const CheckpointHeader values = parse_checkpoint_header(header, checkpoint.string());
  check_resume_options(values.config, values.iteration, config, checkpoint.string());
  SceneOptions options = scene_options(config);
  options.load_images = false;
  check_scene(header, load_scene(options), checkpoint.string());
}

void share_plan(Communicator& ranks, TrainPlan& plan) {
  nlohmann::ordered_json words;
  if (ranks.is_first()) {
    words = {{"config", config_to_json(plan.config)}, {"fixed", plan.fixed}, {"checkpoint", plan.checkpoint.string()}};
  }
  const std::string plan_of_first = ranks.exchange("plan", words.dump()).front();
  if (ranks.is_first()) return;
  words = nlohmann::ordered_json::parse(plan_of_first);
  config_from_json(plan.config, words["config"], "the plan of rank 0");
  plan.fixed = words["fixed"];
  plan.checkpoint = words["checkpoint"].get<std::string>();
}

}  // namespace b3dgs
