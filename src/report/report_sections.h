// Sections that the reports of one training and of a comparison share. Each function returns HTML; where data is
// missing, it says so in a sentence.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "report/html_report.h"
#include "report/run_info.h"
#include "report/svg/svg_chart.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// A training with its label and its colour, which are the same in all charts of a report.
struct LabeledRun {
  std::string name;
  const TrainHistory& history;
  const RunInfo& info;
  int color = 0;  // of the palette
};

/// A remark on PSNR and SSIM with --train_test_exp.
inline constexpr const char* kMeasuredHalf =
    "PSNR and SSIM are those of the right half of each test view, with colours fitted to its left half "
    "(--train_test_exp).";

/// One curve per run that has values of this field.
std::vector<ChartSeries> curves(const std::vector<LabeledRun>& runs, std::optional<double> LogPoint::*field);
/// Numbers of Gaussians.
std::vector<ChartSeries> count_curves(const std::vector<LabeledRun>& runs);

/// What is drawn over the iterations: "PSNR" in "dB".
struct Quantity {
  std::string name, unit;  // unit may be empty
  std::string caption;
  bool from_zero = true;
};

/// A chart over the iterations, or a sentence if no curve has two points; empty if there is no point at all.
std::string curve_figure(const Quantity& quantity, const std::vector<ChartSeries>& series,
                         const std::vector<ChartEvent>& events = {}, int height = 220);

/// Mean time per step by stage, ms, over all samples in a log.
NamedTimes mean_stages(const TrainHistory& history);

std::string stage_section(const std::vector<LabeledRun>& runs);

/// Which kernels were used, the candidates' times over the training, and what the timing checks decided.
std::string kernel_section(const TrainHistory& history);

/// How the work is distributed over tiles and pixels.
std::string load_section(const TrainHistory& history);

/// What the terms in the other sections mean.
std::string words_section();

/// Photographs beside the renders of all runs.
std::string preview_section(const std::vector<LabeledRun>& runs);

/// "eval true, seed 7": options in which `own` differs from `base`, without scene, model folder and device; empty if
/// there are none.
std::string changed_options(const TrainConfig& base, const TrainConfig& own);

/// A value as in a sentence.
std::string option_text(const nlohmann::ordered_json& value);

/// "24 photographs, 240 x 160 px", from the model's cameras.json; empty if that cannot be read.
std::string photographs_text(const ModelFolder& folder);

/// A table of `rows`, followed by the properties of the machine.
std::string settings_section(std::vector<html::Row> rows, const nlohmann::ordered_json& machine);

}  // namespace b3dgs
