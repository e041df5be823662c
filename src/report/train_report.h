// report.html of one training, from the files in its model folder.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "model/model_folder.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// What the report shows. @throws InputError if the folder holds no training; IoError
nlohmann::ordered_json train_report_data(const ModelFolder& folder);

/// Writes MODEL/report.html and returns its path. @throws InputError if the folder holds no training; IoError
std::filesystem::path write_train_report(const ModelFolder& folder);

/// How many Gaussians may be floaters; "" if they were not counted after the last iteration.
std::string floaters_text(const TrainHistory& history);

/// Why a training ended with fewer Gaussians than its limit allowed (`limit`: max_gaussians, 0 = none): whether there
/// were as many once, and when. "" within 5 % of the limit, and of a log without counts.
std::string limit_text(const TrainHistory& history, std::int64_t limit);

/// The test views were clearly better after an earlier iteration than at the last evaluation: what was added since fits
/// the training photographs alone.
struct Overfitting {
  int iteration = 0;  // with the highest PSNR
  double lost = 0;    // dB, from there until the last evaluation
};

/// Empty if PSNR at the last evaluation is at most 0.2 dB below the highest.
std::optional<Overfitting> find_overfitting(const TrainHistory& history);

}  // namespace b3dgs
