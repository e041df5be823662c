#include "config/original_options.h"

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

constexpr OriginalOption kTrainOptions[] = {
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

constexpr OriginalOption kModelOptions[] = {
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

template <class Table>
void add_all(CommandLine& line, const Table& table) {
  for (const OriginalOption& option : table) {
    OptionSpec spec;
    spec.name = option.name;
    spec.letter = option.letter;
    spec.kind = option.default_value == nullptr ? OptionSpec::Kind::kFlag : OptionSpec::Kind::kText;
    spec.is_ignored = true;
    line.add(spec);
  }
}

template <class Table>
std::vector<std::string> describe_all(const nlohmann::ordered_json& given, const Table& table) {
  std::vector<std::string> lines;
  for (const OriginalOption& option : table) {
    const bool is_flag = option.default_value == nullptr;
    const auto value = given.find(option.name);
    if (value == given.end() || (!is_flag && *value == option.default_value)) continue;
    const std::string text = is_flag ? "" : " " + option_value_text(*value);
    lines.push_back(detail::concat("--", option.name, text, " has no effect: ", option.reason));
  }
  return lines;
}

}  // namespace

void add_original_train_options(CommandLine& line) {
  add_all(line, kTrainOptions);
}

void add_original_model_options(CommandLine& line) {
  add_all(line, kModelOptions);
}

std::vector<std::string> describe_original_train_options(const nlohmann::ordered_json& given) {
  return describe_all(given, kTrainOptions);
}

std::vector<std::string> describe_original_model_options(const nlohmann::ordered_json& given) {
  return describe_all(given, kModelOptions);
}

}  // namespace b3dgs
