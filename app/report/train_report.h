// report.html of one training, from the files in its model folder.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "app/report/train_log_reader.h"
#include "model/model_folder.h"

namespace b3dgs {

/// Collects the data for a report. Throws InputError if the folder has no training, or IoError.
nlohmann::ordered_json train_report_data(const ModelFolder& folder);

/// Writes MODEL/report.html and returns its path. @throws InputError if the folder has no training; IoError
std::filesystem::path write_train_report(const ModelFolder& folder);

/// Returns how many Gaussians may be floaters, or "" if they were not counted after the last iteration.
std::string floaters_text(const TrainHistory& history);

/// Explains what ended growth (`limit`: max_gaussians, 0 = none). Within 5 % of the limit, this is the limit, and the
/// text says whether the last renders were soft. Otherwise it says whether there were ever as many, and when. Returns
/// "" without a limit, and for a log without counts.
std::string limit_text(const TrainHistory& history, std::int64_t limit);

/// The test views were clearly better after an earlier iteration than at the last evaluation. Gaussians added since
/// then fit only the training photographs.
struct Overfitting {
  int iteration = 0;  // iteration with the highest PSNR
  double lost = 0;    // dB, from there to the last evaluation
};

/// Returns nothing if PSNR at the last evaluation is at most 0.2 dB below the highest.
std::optional<Overfitting> find_overfitting(const TrainHistory& history);

}  // namespace b3dgs
