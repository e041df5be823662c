#include "compare/comparison.h"

#include <optional>
#include <string>
#include <vector>

#include "compare/compare_verdict.h"
#include "config/train_options.h"
#include "core/text.h"
#include "report/page_data.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// The options that are the same in all configurations, and default values for the others.
TrainConfig common_config(const std::vector<Configuration>& configurations) {
  TrainConfig common;
  Json values = config_to_json(common);
  const Json defaults = values, first = config_to_json(configurations.front().config);
  for (const auto& [name, value] : first.items()) values[name] = value;
  for (const Configuration& own : configurations) {
    const Json other = config_to_json(own.config);
    for (const auto& [name, value] : first.items()) {
      if (other.at(name) != value) values[name] = defaults.at(name);
    }
  }
  config_from_json(common, values, /*place=*/"");
  return common;
}

/// The options in which configurations differ: the name, and a text for each configuration.
Json differing(const std::vector<Configuration>& configurations) {
  std::vector<Json> values;
  values.reserve(configurations.size());
  for (const Configuration& own : configurations) values.push_back(config_to_json(own.config));
  Json rows = Json::array();
  for (const auto& [name, first] : values.front().items()) {
    Json row = Json::array({name});
    bool differs = false;
    for (const Json& own : values) {
      row.push_back(option_text(own.at(name)));
      differs = differs || own.at(name) != first;
    }
    if (differs) rows.push_back(row);
  }
  return rows;
}

/// Pairs of name and text.
Json settings(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  Json rows = Json::array({Json::array({"source scene", plan.base.source_path})});
  const ModelFolder first = plan.folder(comparison.configurations.front(), plan.seeds.front());
  if (const std::string photographs = photographs_text(first); !photographs.empty()) {
    rows.push_back({"resolution", photographs});
  }
  std::string seeds;
  for (const std::int64_t seed : plan.seeds) seeds += (seeds.empty() ? "" : ", ") + std::to_string(seed);
  rows.push_back({"seeds", seeds});
  const std::string shared = changed_options(TrainConfig{}, common_config(comparison.configurations));
  rows.push_back({"options of all",
                  (shared.empty() ? "" : shared + "; ") + "otherwise, but for the table below, as in --preset inria"});
  return rows;
}

}  // namespace

Json comparison_report_data(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  const ComparisonPlan& plan = comparison.plan;
  Json runs = Json::array(), machine = Json::object();
  std::vector<NamedInfo> first_runs;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const std::vector<ComparedRun>& own = comparison.runs[i];
    for (const ComparedRun& run : own) {
      runs.push_back(run_data(comparison.configurations[i].name, run.seed, run.history));
    }
    if (!own.front().info.machine.empty()) machine = own.front().info.machine;
    first_runs.push_back({comparison.configurations[i].name, own.front().info});
  }
  Json has_own_kernel = Json::array();
  for (const ComparedConfiguration& own : summary.compared) has_own_kernel.push_back(own.has_own_kernel);
  return {{"kind", "comparison"},
          {"scene", scene_name(plan.base.source_path)},
          {"seeds", plan.seeds},
          {"chunk", plan.chunk},
          {"held_out", first_runs.front().info.held_out},
          {"measures_half", comparison.configurations.front().config.train_test_exp},
          {"reading_s", plan.reading_s},
          {"output_s", comparison.output_s()},
          {"loading", plan.loading_ms > 0 ? describe_loading(comparison) : ""},
          {"repetition", summary.repetition.empty() ? "" : describe_repetition(summary)},
          {"time_criterion", time_criterion(summary)},
          {"quality_criterion", quality_criterion(summary)},
          {"missing_kernels", summary.missing_kernels},
          {"has_own_kernel", has_own_kernel},
          {"summary", to_json(summary)},
          {"settings", settings(comparison)},
          {"options", differing(comparison.configurations)},
          {"machine", machine},
          {"previews", previews_data(first_runs)},
          {"runs", runs}};
}

}  // namespace b3dgs
