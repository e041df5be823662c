// The plan of `b3dgs train`: its options, the training that they describe, and the checks before it begins.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/train/rank_setup.h"
#include "config/option_layers.h"
#include "config/train_config.h"
#include "core/options/command_line.h"
#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/final_config.h"

namespace b3dgs {

class StatusLine;

struct TrainCommandOptions {
  std::string config;
  std::string resume;
  bool overwrite = false;
  bool quiet = false;
  std::string view;  // empty: not shown; see parse_view_place()
  RankOptions rank;
};

template <class Visitor>
void visit_fields(TrainCommandOptions& c, Visitor&& field) {
  field(Option{"config"}, c.config, Any{}, "JSON file with option names as keys; the command line overrides it");
  field(Option{"resume", '\0', {"start_checkpoint"}}.common(), c.resume, Any{},
        "checkpoint or model folder to resume; auto: folder of -m, if it has a checkpoint");
  field(Option{"overwrite"}.common(), c.overwrite, Any{}, "replace an existing model in the output folder");
  field(Option{"gpus"}.common(), c.rank.gpus, Any{},
        "GPUs of this machine to train on, a process for each: a number, or auto for all");
  field(Option{"ranks"}, c.rank.ranks, InRange{0, kMaxStartedRanks},
        "processes to train with (0 = as many as a launcher started; 1 = this one alone)");
  field(Option{"view"}.common(), c.view, Any{},
        "show the training in a browser; may name PORT (0 = any free one) or ADDRESS:PORT");
  field(Option{"quiet"}.common(), c.quiet, Any{}, "print results and warnings only");
}

/// The training, its source and its destination.
struct TrainPlan {
  TrainConfig config;
  std::optional<OptionLayers> layers;           // source of config's values, unless from a checkpoint or model folder
  GivenOptions fixed = GivenOptions::object();  // not scaled by --max_epochs: given options; at a resume, all
  TrainCommandOptions options;
  std::filesystem::path checkpoint;  // to resume, or empty
  nlohmann::ordered_json header;     // of the checkpoint
  bool is_replaced = false;          // whether to replace the model in the folder
};

/// Returns the config in a checkpoint's header. Its model folder is the one that now contains the checkpoint. @throws
/// InputError
TrainConfig config_of_checkpoint(const nlohmann::ordered_json& header, const std::filesystem::path& checkpoint);

/// Returns the options of the training that do not depend on its scene, from the command line, the config file, and the
/// checkpoint or model folder to resume. Without --batch, a step has a view for each rank, and it cannot have fewer.
/// `device`, of all ranks, is a value of --device. @throws InputError
TrainPlan make_plan(const CommandLine& line, StatusLine& status, const TrainCommandOptions& options,
                    const GivenOptions& given, int n_ranks, const std::string& device);

/// The options of the plan, completed for its scene: --max_epochs, --gaussians_per_pixel and --lr_decay_from_epoch
/// become numbers. `lines` are about these numbers and the given options. @throws InputError
struct FittedPlan {
  FinalConfig config;
  std::vector<std::string> lines;
};
FittedPlan fit_to_scene(const TrainPlan& plan, const Scene& scene);

/// Protects an existing model, which may be hours of work. Returns whether to replace it. @throws InputError
bool guard_model(const ModelFolder& folder, const TrainPlan& plan);

/// Checks, before photographs are decoded, that the checkpoint can be resumed with these options, and that it belongs
/// to this scene at this image size. @throws InputError
void check_checkpoint(const TrainPlan& plan);

/// @throws InputError naming an option of this rank that differs from rank 0
void check_same_options(Communicator& ranks, const GivenOptions& given);

/// Sends the plan of rank 0 to the others, which do not look at the model folder.
void share_plan(Communicator& ranks, TrainPlan& plan);

}  // namespace b3dgs
