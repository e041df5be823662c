// A comparison on disk: OUTPUT/compare.json, OUTPUT/report.html, and the model folders OUTPUT/CONFIGURATION/seed_N. All
// results are computed from the files of the runs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "app/compare/compare_config.h"
#include "app/compare/compare_summary.h"
#include "app/report/page_data.h"

namespace b3dgs {

/// The settings of a comparison. They are stored in compare.json, so that it can be resumed.
struct ComparisonPlan {
  TrainConfig base;    // model_path is the comparison's folder
  GivenOptions given;  // options given for all configurations; `base` follows from them
  std::string configs;
  std::vector<std::int64_t> seeds;
  bool has_repetition = false;  // trains the baseline twice (--noise)
  int chunk = 0;                // iterations per turn
  Photographs photographs;      // for training; none before the scene has been read
  double reading_s = 0;         // reading the scene, sum over all sessions

  std::filesystem::path root() const { return base.model_path; }
  std::vector<Configuration> configurations() const;
  /// Applies --max_epochs, to `base` as well.
  void set_photographs(const Photographs& of_scene);
  int longest() const;  // iterations of the longest configuration
  ModelFolder folder(const Configuration& configuration, std::int64_t seed) const;
};

/// Writes compare.json with only the plan. write_comparison() adds the results. @throws IoError
void write_plan(const ComparisonPlan& plan);

/// @throws InputError if compare.json is missing or damaged
ComparisonPlan read_plan(const std::filesystem::path& root);

struct Comparison {
  ComparisonPlan plan;
  std::vector<ConfigurationHistory> configurations;
  std::vector<std::vector<RunInfo>> infos;  // [configuration][seed]
  nlohmann::ordered_json summary;           // summarize_comparison()

  double output_s() const;  // evaluation, saving and checkpoints, all runs
};

/// Reads the results of all runs so far.
Comparison load_comparison(const ComparisonPlan& plan);

/// Writes compare.json and report.html. @throws IoError
void write_comparison(const Comparison& comparison);

/// Returns the result for standard output.
std::string describe_comparison(const Comparison& comparison);

/// Collects the data for a report: the summary, and the runs of all seeds. Throws IoError, or InputError if an image
/// cannot be read.
nlohmann::ordered_json comparison_report_data(const Comparison& comparison);

}  // namespace b3dgs
