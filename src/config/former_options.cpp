#include "config/former_options.h"

namespace b3dgs {
namespace {

struct FormerOption {
  const char* name;
  const char* value;   // JSON, what it always is now; null: a flag; kVaries
  const char* reason;  // ends "--name X has no effect: "; null: no line, since another option says it
  char letter = '\0';  // or none
};

/// It was set by presets and strategies or scaled, so numbers in files need no line.
constexpr const char* kVaries = "varies";

constexpr const char* kOriginal = "only the original 3DGS code has it";
constexpr const char* kPhotographs = "photographs fill up to half of the free GPU memory, then host memory";
constexpr const char* kTraining = "the training's setting is used";
constexpr const char* kSplit = "choose views with render --path test|train and eval --split test|train";

constexpr FormerOption kFormerOptions[] = {
    // Of the original 3DGS code.
    {"disable_viewer", nullptr, kOriginal},
    {"debug", nullptr, kOriginal},
    {"detect_anomaly", nullptr, kOriginal},
    {"compute_cov3D_python", nullptr, kOriginal},
    {"convert_SHs_python", nullptr, kOriginal},
    {"data_device", "\"cuda\"", kPhotographs},
    {"optimizer_type", "\"default\"", kOriginal},
    {"ip", "\"127.0.0.1\"", kOriginal},
    {"port", "6009", "the page of a training is at --view PORT"},
    {"debug_from", "-1", kOriginal},
    {"position_lr_delay_mult", "0.01", kOriginal},
    {"exposure_lr_delay_steps", "0", kOriginal},
    {"exposure_lr_delay_mult", "0.0", kOriginal},
    // Of earlier versions; docs/lab/experiments.md has what was measured.
    {"rank_splats", "2000000", "each rank renders about 2,000,000 splats at a time, or one view"},
    {"mask_alpha_weight", "1", "the weight is 1"},
    {"skip_share", "0", "no step is skipped"},
    {"skip_from_iter", "15500", nullptr},
    {"huber", "0", "the loss is L1 and D-SSIM"},
    {"huber_from_iter", "0", nullptr},
    {"reg_from_iter", "0", "--opacity_reg and --scale_reg act from the first iteration"},
    {"noise_from_iter", "0", "noise acts from the first iteration"},
    {"growth", "0.05", "mcmc adds 5 % in each round"},
    {"score_power", "2", "errors are squared"},
    {"abs_grad_threshold", "0", "every Gaussian with an error may be split"},
    {"parents", "\"draw\"", "Gaussians to split are drawn in proportion to their error"},
    {"split_moments", "\"zero\"", "the parts of a Gaussian begin with zero moments"},
    {"budget_power", "0.5", "the count grows with the square root of the time"},
    {"opacity_decay", "1", "opacities do not decay"},
    {"pose_opt_lr", "0.0005", "poses are refined at a rate of 0.0005"},
    {"pose_opt_from_iter", kVaries, "poses are refined after --densify_from_iter"},
    {"bilateral_grid_lr", "0.002", "the learning rate of grids is 0.002"},
    {"bilateral_grid_tv", "10", "the weight of the total variation is 10"},
    {"prune_opacity", "0.005", "Gaussians with an opacity below 0.005 are removed"},
    {"min_opacity", "0.005", "Gaussians with an opacity below 0.005 are removed"},
    {"prune_world_size", "0.1", "only strategy default removes large Gaussians: above 0.1 x scene extent"},
    {"prune_screen_size", "0", "Gaussians are not removed for their size on the screen"},
    {"init_opacity", "0.1", "Gaussians start with an opacity of 0.1"},
    {"init_scale", "1", "Gaussians start as large as the distance to their neighbours"},
    {"noise_lr", kVaries, "the noise of mcmc is 50000 x the learning rate of the means"},
    {"prune_interval", kVaries, "removals by --prune_weight follow --opacity_reset_interval"},
    {"prune_until_iter", kVaries, "removals by --prune_weight end with 14/15 of --position_lr_max_steps"},
    {"backward_kernel", kVaries, "--kernel says which backward kernel belongs to it"},
    {"kernel_policy", kVaries, "adaptive goes back to a kernel when it is faster again"},
    {"kernel_candidates", kVaries, "adaptive chooses between segmented and sub-tile, published between the paper's"},
    {"kernel_check_views", "5", "a check times 5 views"},
    {"kernel_times_interval", kVaries, "the times of both kernels are logged at --kernel_check_interval"},
    {"stats_interval", kVaries, "load statistics are logged every 1000 iterations"},
    {"checkpoint_interval", "0", "--checkpoint_minutes and --checkpoint_iterations say when to write checkpoints"},
    {"keep_checkpoints", "2", "the 2 newest checkpoints are kept, and those of --checkpoint_iterations"},
    {"tile", "\"16x16\"", "tiles are 16 x 16 px"},
    {"image_cache_gb", "-1", kPhotographs},
};

/// Of render.py and metrics.py in the original 3DGS code.
constexpr FormerOption kFormerModelOptions[] = {
    {"skip_train", nullptr, kSplit},
    {"skip_test", nullptr, kSplit},
    {"eval", nullptr, kTraining},
    {"images", kVaries, kTraining, 'i'},
    {"depths", kVaries, kTraining, 'd'},
    {"train_test_exp", nullptr, kTraining},
    {"sh_degree", kVaries, kTraining},
    {"antialiasing", nullptr, kTraining},
    {"data_device", "\"cuda\"", kPhotographs},
    {"debug", nullptr, kOriginal},
    {"compute_cov3D_python", nullptr, kOriginal},
    {"convert_SHs_python", nullptr, kOriginal},
};

struct FormerName {
  const char *option, *value, *now;
};

constexpr FormerName kFormerNames[] = {
    {"strategy", "balanced", "budget"},
    {"preset", "original", "inria"},
    {"kernel", "paper", "published"},
};

bool has_usual_value(const FormerOption& option, const nlohmann::ordered_json& value) {
  if (option.value == nullptr) return false;
  if (option.value == kVaries) return value.is_number();
  const auto usual = nlohmann::ordered_json::parse(option.value);
  return value == usual || (usual.is_number() && value == usual.dump());
}

template <class Table>
void add_all(CommandLine& line, const Table& table) {
  for (const FormerOption& option : table) {
    OptionSpec spec;
    spec.name = option.name;
    spec.letter = option.letter;
    spec.kind = option.value == nullptr ? OptionSpec::Kind::kFlag : OptionSpec::Kind::kText;
    spec.is_ignored = true;
    line.add(spec);
  }
}

template <class Table>
std::vector<std::string> describe_all(const nlohmann::ordered_json& options, const Table& table) {
  std::vector<std::string> lines;
  for (const FormerOption& option : table) {
    const auto own = options.find(option.name);
    if (own == options.end() || option.reason == nullptr || has_usual_value(option, *own)) continue;
    const std::string text = option.value == nullptr ? "" : " " + option_value_text(*own);
    lines.push_back(detail::concat("--", option.name, text, " has no effect: ", option.reason));
  }
  return lines;
}

}  // namespace

void add_former_options(CommandLine& line) {
  add_all(line, kFormerOptions);
}

void add_former_model_options(CommandLine& line) {
  add_all(line, kFormerModelOptions);
}

nlohmann::ordered_json present_options(nlohmann::ordered_json options) {
  if (!options.is_object()) return options;
  for (const FormerOption& option : kFormerOptions) options.erase(option.name);
  for (const FormerName& name : kFormerNames) {
    if (const auto own = options.find(name.option); own != options.end() && *own == name.value) *own = name.now;
  }
  return options;
}

const char* present_name(const std::string& option, const std::string& value) {
  for (const FormerName& name : kFormerNames) {
    if (option == name.option && value == name.value) return name.now;
  }
  return nullptr;
}

std::vector<std::string> describe_former_options(const nlohmann::ordered_json& options) {
  std::vector<std::string> lines = describe_all(options, kFormerOptions);
  for (const FormerName& name : kFormerNames) {
    if (options.value(name.option, nlohmann::ordered_json()) != name.value) continue;
    lines.push_back(detail::concat("--", name.option, " ", name.value, " is now --", name.option, " ", name.now));
  }
  return lines;
}

std::vector<std::string> describe_former_model_options(const nlohmann::ordered_json& options) {
  return describe_all(options, kFormerModelOptions);
}

}  // namespace b3dgs
