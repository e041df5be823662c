#include "app/train/train_plan.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/common/torch/model.h"
#include "app/report/page_data.h"
#include "config/batch_steps.h"
#include "config/original_options.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "core/files/own_files.h"
#include "core/json_text.h"
#include "core/text.h"
#include "model/checkpoint/checkpoint_header.h"
#include "scene/crop_region.h"
#include "train/checkpoint/checkpoint.h"
#include "train/final_config.h"
#include "train/scene_limits.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::string default_model_path(const std::string& source_path) {
  return (fs::path("output") / scene_name(source_path)).string();
}

/// Returns the newest valid checkpoint of a model folder, or "" if it has no checkpoints. @throws InputError if all are
/// damaged
fs::path newest_checkpoint(const ModelFolder& folder, StatusLine& status) {
  fs::path checkpoint = newest_valid_checkpoint(folder, [&](const std::string& message) { status.warn(message); });
  if (checkpoint.empty() && !folder.checkpoint_iterations().empty()) {
    input_error("all checkpoints are damaged: ", folder.root().string(),
                "; start again in another folder (-m), or in this one with --overwrite instead of --resume");
  }
  return checkpoint;
}

/// Returns the checkpoint to resume, or "" to start from the beginning. With --resume auto, sets config.model_path if
/// empty.
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
                "start a training with b3dgs train SOURCE_PATH -m ", shell_quote(config.model_path));
  }
  if (folder.holds_model()) {
    const int saved = folder.ply_iterations().back();
    input_error("no checkpoint to resume in ", config.model_path, ", which holds the PLY of iteration ", saved, " (",
                folder.ply(saved).string(), "); train in another folder (-m), or replace this model with --overwrite");
  }
  status.print("no checkpoint to resume in " + config.model_path + ", starting from the beginning");
  return "";
}

/// @throws InputError if a rank would render nothing
void check_batch(int batch, int n_ranks) {
  if (batch >= n_ranks) return;
  const std::string larger = n_ranks <= kMaxBatch ? detail::concat("--batch ", n_ranks, " or more, or ") : "";
  input_error("--batch ", batch, " is too small for ", n_ranks, " ranks, each of which renders at least one view of a ",
              "step; use ", larger, "at most ", batch, batch == 1 ? " rank" : " ranks");
}

/// @throws InputError if the training reads from a path where it writes, or where --overwrite removes files
void check_inputs_are_elsewhere(const ModelFolder& folder, const TrainPlan& plan) {
  const TrainConfig& config = plan.config;
  const fs::path model = real_path(folder.root());
  const auto check = [&](const char* option, const std::string& value, const fs::path& base) {
    if (value.empty()) return;
    const fs::path path = real_path(base / value);
    if (path == model) {
      input_error(option, " ", value, " and the model folder are the same; choose another folder with -m");
    }
    const fs::path inside = path.lexically_relative(model);
    if (inside.empty()) return;
    for (const char* part :
         {"point_cloud", "checkpoints", "report", "test", "train", "interpolated", "replaced", "input.ply"}) {
      if (*inside.begin() != part) continue;
      input_error(option, " ", value, " is where the training writes its own files (", (folder.root() / part).string(),
                  "); copy it elsewhere first");
    }
  };
  const fs::path here = fs::current_path(), scene = config.source_path;
  check("-s", config.source_path, here);
  check("--init_ply", config.init_ply, here);
  for (const fs::path& base : {scene, here}) {  // folders in which they are looked for
    check("--images", config.images, base);
    check("--masks", config.masks, base);
    check("--depths", config.depths, base);
  }
}

}  // namespace

TrainConfig config_of_checkpoint(const nlohmann::ordered_json& header, const fs::path& checkpoint) {
  TrainConfig config;
  if (!header.contains("config"))
    input_error("not a training checkpoint: ", checkpoint.string(), " (expected a config in its header)");
  config_from_json(config, header["config"], checkpoint.string());
  config.device = TrainConfig{}.device;  // depends on the machine, not on the training
  const fs::path folder = fs::absolute(checkpoint).lexically_normal().parent_path();
  if (folder.filename() == "checkpoints") config.model_path = folder.parent_path().string();
  return config;
}

TrainPlan make_plan(const CommandLine& line, StatusLine& status, const TrainCommandOptions& options,
                    const GivenOptions& given, int n_ranks, const std::string& device) {
  TrainPlan plan;
  plan.options = options;
  TrainConfig& config = plan.config;
  if (options.resume == "auto" && options.overwrite) {
    input_error("--resume auto and --overwrite exclude each other: one continues the model in the output folder, the ",
                "other replaces it");
  }
  for (const std::string& text : describe_original_options(line.given(), OriginalScript::kTrain)) status.warn(text);
  const auto apply_given_at_resume = [&] {
    for (const std::string& text : apply_at_resume(config, given)) status.warn(text);
    plan.layers.reset();
  };
  plan.layers = resolve_options(given);
  config = plan.layers->config;
  if (!options.resume.empty()) plan.checkpoint = find_checkpoint(config, options, status);
  if (!plan.checkpoint.empty()) {
    const std::string named_folder = config.model_path;
    plan.header = read_checkpoint_header(plan.checkpoint);
    config = config_of_checkpoint(plan.header, plan.checkpoint);
    apply_given_at_resume();
    if (!named_folder.empty()) config.model_path = named_folder;
  } else if (options.resume == "auto" && config.source_path.empty()) {
    // The training was interrupted before its first checkpoint.
    const std::string folder = config.model_path;
    config = ModelFolder(folder).read_config();
    config.device = TrainConfig{}.device;
    config.model_path = folder;
    apply_given_at_resume();
  }
  if (n_ranks > 1 && plan.layers && !given.contains("batch")) {
    config.batch = std::min(n_ranks, kMaxBatch);  // each rank renders a view of a step
  }
  check_batch(config.batch, n_ranks);
  if (config.source_path.empty())
    input_error("missing argument: SOURCE_PATH; usage: b3dgs train SOURCE_PATH, or -s SOURCE_PATH");
  if (config.model_path.empty()) config.model_path = default_model_path(config.source_path);
  make_absolute(config.source_path);
  make_absolute(config.init_ply);
  if (!config.crop.empty()) config.crop = crop_text(parse_crop(config.crop));  // other ranks may not have its file
  plan.fixed = plan.layers ? given : config_to_json(config);
  config.device = device;
  return plan;
}

FittedPlan fit_to_scene(const TrainPlan& plan, const Scene& scene) {
  const Photographs photographs = training_photographs(scene);
  TrainConfig before = plan.config;
  limit_epochs(before, photographs, plan.fixed);
  FittedPlan fitted{finalize(before, scene), {}};
  const TrainConfig& config = fitted.config.options;
  std::vector<std::string>& lines = fitted.lines;
  lines.push_back(describe_epochs(config, photographs));
  if (config.max_gaussians != before.max_gaussians) {
    lines.push_back(detail::concat("limit       ", format_count(config.max_gaussians),
                                   " Gaussians (--gaussians_per_pixel ", config.gaussians_per_pixel, ")"));
  }
  if (config.lr_decay_from_iter != before.lr_decay_from_iter) {
    lines.push_back(detail::concat("rates       decay from iteration ", config.lr_decay_from_iter,
                                   " (--lr_decay_from_epoch ", config.lr_decay_from_epoch, ")"));
  }
  if (!plan.layers) return fitted;
  OptionLayers layers = *plan.layers;
  layers.epoch_scale = limit_epochs(layers.config, photographs, layers.given);
  for (std::string& line : describe_options(layers)) lines.push_back(std::move(line));
  return fitted;
}

bool guard_model(const ModelFolder& folder, const TrainPlan& plan) {
  if (holds_comparison(folder.root())) {
    input_error("output folder holds a comparison: ", folder.root().string(), "; choose another folder with -m");
  }
  if (!plan.checkpoint.empty()) {
    const fs::path kept = real_path(plan.checkpoint).parent_path().parent_path();
    if (kept.filename() == "replaced" && fs::exists(kept.parent_path() / OwnFiles::kRecord)) {
      input_error("checkpoint of an earlier model, which --overwrite keeps until the new one is complete: ",
                  plan.checkpoint.string(), "; move ", kept.string(), " elsewhere first, and resume it there");
    }
    const auto training_id = plan.header.value("training_id", "");
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
    if (is_replaced) check_inputs_are_elsewhere(folder, plan);
    return is_replaced;
  }
  check_inputs_are_elsewhere(folder, plan);
  // Without a model there is nothing to replace. A folder report/, for example, belongs to the user.
  if (plan.options.overwrite) return folder.holds_model() || !folder.training_id().empty();
  if (!folder.holds_model()) return false;
  input_error("output folder already holds a model: ", folder.root().string(), "; ",
              folder.checkpoint_iterations().empty() ? "" : "resume it with --resume auto, ",
              "replace it with --overwrite, or choose another folder with -m");
}

void check_checkpoint(const TrainPlan& plan) {
  if (plan.checkpoint.empty()) return;
  const std::string place = plan.checkpoint.string();
  const CheckpointHeader values = parse_checkpoint_header(plan.header, place);
  check_resume_options(values.config, values.iteration, plan.config, place);
  SceneOptions options = scene_options(plan.config);
  options.load_images = false;
  options.frame = checkpoint_frame(plan.header, place);
  check_scene(plan.header, load_scene(options), place);
}

void check_same_options(Communicator& ranks, const GivenOptions& given) {
  const auto first = parse_json(ranks.exchange("options", dump_json(given)).front());
  const auto text = [](const nlohmann::ordered_json& options, const std::string& name) {
    return options.contains(name) ? json_excerpt(options.at(name)) : "not given";
  };
  nlohmann::ordered_json all = first;
  all.update(given);
  for (const auto& [name, value] : all.items()) {
    if (given.contains(name) && first.contains(name) && given.at(name) == first.at(name)) continue;
    input_error("--", name, ": rank ", ranks.rank(), " was started with other options than rank 0 (expected ",
                text(first, name), ", found ", text(given, name),
                "); start all ranks with the same command, or this training alone with --ranks 1");
  }
}

void share_plan(Communicator& ranks, TrainPlan& plan) {
  nlohmann::ordered_json words;
  if (ranks.is_first()) {
    words = {{"config", config_to_json(plan.config)}, {"fixed", plan.fixed}, {"checkpoint", plan.checkpoint.string()}};
  }
  const std::string plan_of_first = ranks.exchange("plan", dump_json(words)).front();
  if (ranks.is_first()) return;
  words = parse_json(plan_of_first);
  config_from_json(plan.config, words["config"], "the plan of rank 0");
  plan.fixed = words["fixed"];
  plan.checkpoint = words["checkpoint"].get<std::string>();
  if (!plan.checkpoint.empty()) plan.header = read_checkpoint_header(plan.checkpoint);
}

}  // namespace b3dgs
