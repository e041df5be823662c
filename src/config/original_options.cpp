#include "config/original_options.h"

#include <initializer_list>

namespace b3dgs {
namespace {

struct OriginalOption {
  const char* name;
  const char* default_value;  // "" if every value is reported; null for a flag
  const char* reason;         // ends "--name X has no effect: "
  char letter = '\0';         // or none
};

constexpr const char* kOriginal = "only the original 3DGS code has it";
constexpr const char* kPhotographs = "photographs fill up to half of the free GPU memory, then host memory";
constexpr const char* kTraining = "the training's setting is used";
constexpr const char* kSplit = "choose views with render --path test|train and eval --split test|train";

constexpr std::initializer_list<OriginalOption> kTrainOptions = {
    {"disable_viewer", nullptr, kOriginal},
    {"debug", nullptr, kOriginal},
    {"detect_anomaly", nullptr, kOriginal},
    {"compute_cov3D_python", nullptr, kOriginal},
    {"convert_SHs_python", nullptr, kOriginal},
    {"data_device", "cuda", kPhotographs},
    {"optimizer_type", "default", kOriginal},
    {"ip", "127.0.0.1", kOriginal},
    {"port", "6009", "the page of a training is at --view PORT"},
    {"debug_from", "-1", kOriginal},
    {"position_lr_delay_mult", "0.01", kOriginal},
    {"exposure_lr_delay_steps", "0", kOriginal},
    {"exposure_lr_delay_mult", "0.0", kOriginal},
};

constexpr std::initializer_list<OriginalOption> kModelOptions = {
    {"skip_train", nullptr, kSplit},
    {"skip_test", nullptr, kSplit},
    {"eval", nullptr, kTraining},
    {"images", "", kTraining, 'i'},
    {"depths", "", kTraining, 'd'},
    {"train_test_exp", nullptr, kTraining},
    {"sh_degree", "", kTraining},
    {"antialiasing", nullptr, kTraining},
    {"data_device", "cuda", kPhotographs},
    {"debug", nullptr, kOriginal},
    {"compute_cov3D_python", nullptr, kOriginal},
    {"convert_SHs_python", nullptr, kOriginal},
};

std::initializer_list<OriginalOption> options_of(OriginalScript script) {
  return script == OriginalScript::kTrain ? kTrainOptions : kModelOptions;
}

}  // namespace

void add_original_options(CommandLine& line, OriginalScript script) {
  for (const OriginalOption& option : options_of(script)) {
    OptionSpec spec;
    spec.name = option.name;
    spec.letter = option.letter;
    spec.kind = option.default_value == nullptr ? OptionSpec::Kind::kFlag : OptionSpec::Kind::kText;
    spec.is_ignored = true;
    line.add(spec);
  }
}

std::vector<std::string> describe_original_options(const nlohmann::ordered_json& given, OriginalScript script) {
  std::vector<std::string> lines;
  for (const OriginalOption& option : options_of(script)) {
    const bool is_flag = option.default_value == nullptr;
    const auto value = given.find(option.name);
    if (value == given.end() || (!is_flag && *value == option.default_value)) continue;
    const std::string text = is_flag ? "" : " " + option_value_text(*value);
    lines.push_back(detail::concat("--", option.name, text, " has no effect: ", option.reason));
  }
  return lines;
}

}  // namespace b3dgs
