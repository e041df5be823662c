// Sections that the reports of one training and of a comparison share. Each is HTML; where its data is missing, a
// sentence says so.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "report/run_info.h"
#include "report/svg/svg_chart.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// A training as it stands in a report: its name and a colour of the palette, the same in all charts.
struct LabeledRun {
  std::string name;
  const TrainHistory& history;
  const RunInfo& record;
  int color = 0;
};

/// One curve per run of a field that not every line has.
std::vector<ChartSeries> curves(const std::vector<LabeledRun>& runs, std::optional<double> LogPoint::*field);
std::vector<ChartSeries> count_curves(const std::vector<LabeledRun>& runs);

/// Mean time per step by stage, over all samples of a log.
NamedTimes mean_stages(const TrainHistory& history);

std::string stage_section(const std::vector<LabeledRun>& runs);

/// The candidates' times over the training and the decisions; `history` is of a run that chose its kernels.
std::string kernel_section(const TrainHistory& history);

std::string load_section(const TrainHistory& history);

/// Photograph and renders side by side.
std::string preview_section(const std::vector<LabeledRun>& runs);

std::string machine_section(const nlohmann::ordered_json& machine, const std::vector<std::vector<std::string>>& more);

}  // namespace b3dgs
