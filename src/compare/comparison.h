// A comparison on disk: OUTPUT/compare.json, OUTPUT/report.html, and a model folder for each run,
// OUTPUT/CONFIGURATION/seed_N. All figures come from the runs' own files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "compare/compare_config.h"
#include "compare/compare_summary.h"
#include "report/run_info.h"

namespace b3dgs {

/// What to compare: enough to go on with it.
struct ComparisonPlan {
  TrainConfig base;  // model_path is the comparison's folder
  std::string configs;
  std::vector<std::int64_t> seeds;
  bool has_repetition = false;  // trains the baseline twice (--noise)
  int chunk = 0;                // iterations of a turn
  double reading_s = 0;         // of the scene, all sessions so far
  // What loading the candidates' code takes in a fresh process, as measured before the first turn. Every configuration
  // that chooses its kernel has it in its times: `train` pays it too, while here all trainings share one process.
  double loading_ms = 0;

  std::filesystem::path root() const { return base.model_path; }
  std::vector<Configuration> configurations() const;
  ModelFolder folder(const Configuration& configuration, std::int64_t seed) const;
};

/// The plan alone; the figures follow with write_comparison(). @throws IoError
void write_plan(const ComparisonPlan& plan);

/// @throws InputError if the folder holds no comparison or its file is damaged
ComparisonPlan read_plan(const std::filesystem::path& root);

bool holds_comparison(const std::filesystem::path& root);

struct ComparedRun {
  std::int64_t seed = 0;
  TrainHistory history;  // with the plan's loading_ms in its times, if the configuration chooses
  RunInfo record;
};

struct Comparison {
  ComparisonPlan plan;
  std::vector<Configuration> configurations;
  std::vector<std::vector<ComparedRun>> runs;  // [configuration][seed]
  ComparisonSummary summary;

  double output_s() const;  // evaluation, saving and checkpoints of all runs
};

/// Reads what the runs have written so far.
Comparison load_comparison(const ComparisonPlan& plan);

/// Writes compare.json and report.html. @throws IoError
void write_comparison(const Comparison& comparison);

void print_comparison(const Comparison& comparison);

/// A line about the plan's loading_ms.
std::string describe_loading(const Comparison& comparison);

}  // namespace b3dgs
