// The parts of a report's data (JSON) that trainings and comparisons share. page/ reads them.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "report/run_info.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// "stages_ms" (mean per step), "curves" (an array per quantity, null where it was not measured), "kernel_checks" and
/// "load_statistics", as in compare.json.
nlohmann::ordered_json history_json(const TrainHistory& history);

/// A training as the page draws it: its name and seed, history_json(), and kernels.
nlohmann::ordered_json run_data(const std::string& name, std::int64_t seed, const TrainHistory& history);

/// One entry per view: the photograph and the renders of all runs, as data URIs. Images that are missing are left out.
/// @throws IoError, InputError if one is there but cannot be read
struct NamedInfo {
  std::string name;
  const RunInfo& info;
};
nlohmann::ordered_json previews_data(const std::vector<NamedInfo>& runs);

/// "eval true, seed 7": options in which `own` differs from `base`, without scene, model folder and device; empty if
/// there are none.
std::string changed_options(const TrainConfig& base, const TrainConfig& own);

/// A value as in a sentence.
std::string option_text(const nlohmann::ordered_json& value);

/// "24 photographs, 240 x 160 px", from the model's cameras.json; empty if that cannot be read.
std::string photographs_text(const ModelFolder& folder);

}  // namespace b3dgs
