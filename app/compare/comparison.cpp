#include "app/compare/comparison.h"

#include <algorithm>

#include "app/compare/compare_summary.h"
#include "app/compare/compare_verdict.h"
#include "app/report/page_data.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "model/model_folder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

fs::path plan_path(const fs::path& root) {
  return root / kComparisonFile;
}

Json to_json(const ComparisonPlan& plan) {
  return {{"configs", plan.configs},
          {"seeds", plan.seeds},
          {"noise", plan.has_repetition},
          {"chunk", plan.chunk},
          {"reading_s", plan.reading_s},
          {"given", plan.given},
          {"photographs", plan.photographs.n},
          {"overlap", plan.photographs.overlap},
          {"config", config_to_json(plan.base)}};
}

Json to_json(const Comparison& comparison) {
  Json json = {{"plan", to_json(comparison.plan)}, {"summary", comparison.summary}};
  json["machine"] = Json::object();
  json["runs"] = Json::array();
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const ConfigurationHistory& configuration = comparison.configurations[i];
    for (std::size_t k = 0; k < configuration.by_seed.size(); ++k) {
      const std::int64_t seed = comparison.plan.seeds[k];
      const RunInfo& info = comparison.infos[i][k];
      if (!info.machine.empty()) json["machine"] = info.machine;
      const fs::path folder = comparison.plan.folder(configuration, seed).root();
      json["runs"].push_back({{"configuration", configuration.name},
                              {"seed", seed},
                              {"folder", folder.lexically_relative(comparison.plan.root()).string()},
                              {"differs", config_differences(comparison.plan.base, configuration.config)},
                              {"output_s", info.output_s}});
      json["runs"].back().update(history_json(configuration.by_seed[k]));
    }
  }
  return json;
}

}  // namespace

std::vector<Configuration> ComparisonPlan::configurations() const {
  std::vector<Configuration> all = parse_configurations(configs, base, given, photographs);
  if (has_repetition) all.push_back(repeat_baseline(all));
  return all;
}

void ComparisonPlan::set_photographs(const Photographs& of_scene) {
  photographs = of_scene;
  limit_epochs(base, photographs, given);
}

int ComparisonPlan::longest() const {
  int longest = 0;
  for (const Configuration& own : configurations()) longest = std::max(longest, own.config.iterations);
  return longest;
}

ModelFolder ComparisonPlan::folder(const Configuration& configuration, std::int64_t seed) const {
  return ModelFolder(root() / configuration.name / ("seed_" + std::to_string(seed)));
}

double Comparison::output_s() const {
  double sum = 0;
  for (const std::vector<RunInfo>& of_configuration : infos) {
    for (const RunInfo& info : of_configuration) sum += info.output_s;
  }
  return sum;
}

void write_plan(const ComparisonPlan& plan) {
  write_json_file(plan_path(plan.root()), {{"plan", to_json(plan)}}, 1);
}

ComparisonPlan read_plan(const fs::path& root) {
  const fs::path path = plan_path(root);
  if (!holds_comparison(root)) input_error(root.string(), ": no comparison to resume (compare.json not found)");
  const Json json = read_json_file(path.string(), "a file of b3dgs compare");
  ComparisonPlan plan;
  try {
    const Json& own = json.at("plan");
    plan.configs = own.at("configs").get<std::string>();
    plan.seeds = own.at("seeds").get<std::vector<std::int64_t>>();
    plan.chunk = std::max(1, own.at("chunk").get<int>());
    plan.reading_s = own.at("reading_s").get<double>();
    plan.has_repetition = own.at("noise").get<bool>();
    config_from_json(plan.base, own.at("config"), path.string());
    plan.given = own.at("given");
    plan.photographs = own.at("photographs").get<std::size_t>();
    plan.photographs.overlap = own.at("overlap").get<double>();
  } catch (const nlohmann::json::exception& error) {
    input_error(path.string(), ": not a file of b3dgs compare, or damaged (",
                first_line(error.what()).substr(std::string(error.what()).find("] ") + 2),
                "); begin the comparison again with --overwrite, which keeps this file, or in another folder (-m)");
  }
  plan.base.model_path = root.string();     // the folder may have been moved
  plan.base.device = TrainConfig{}.device;  // chosen again on this machine
  plan.given.erase("device");
  return plan;
}

Comparison load_comparison(const ComparisonPlan& plan) {
  Comparison comparison{plan, {}, {}, {}};
  for (const Configuration& configuration : plan.configurations()) {
    comparison.configurations.push_back({configuration, {}});
    std::vector<TrainHistory>& by_seed = comparison.configurations.back().by_seed;
    std::vector<RunInfo>& infos = comparison.infos.emplace_back();
    for (const std::int64_t seed : plan.seeds) {
      const ModelFolder folder = plan.folder(configuration, seed);
      by_seed.push_back(read_train_log(folder.log()));
      infos.push_back(read_run_info(folder));
    }
  }
  comparison.summary = summarize_comparison(comparison.configurations, plan.longest(), plan.chunk);
  return comparison;
}

namespace {

/// Returns pairs of name and text: scene, seeds, and the options shared by all configurations that differ from the
/// values of the baseline's preset. Options in which configurations differ are added to `rows`, with the name and a
/// text for each configuration.
Json settings(const Comparison& comparison, Json& rows) {
  const ComparisonPlan& plan = comparison.plan;
  std::vector<Json> all;
  for (const ConfigurationHistory& own : comparison.configurations) all.push_back(config_to_json(own.config));
  const TrainConfig& baseline = comparison.configurations.front().config;
  const Json defaults = config_to_json(preset_options(baseline));
  Json shared = defaults;
  for (const auto& [name, first] : all.front().items()) {
    const bool differs = std::any_of(all.begin(), all.end(),
                                     [&, key = name, &value = first](const Json& own) { return own[key] != value; });
    if (!differs) {
      shared[name] = first;
      continue;
    }
    Json& row = rows.emplace_back(Json::array({name}));
    for (const Json& own : all) row.push_back(option_text(own[name]));
  }
  std::string seeds;
  for (const std::int64_t seed : plan.seeds) seeds += (seeds.empty() ? "" : ", ") + std::to_string(seed);
  const std::string changed = changed_options(defaults, shared);
  Json pairs = scene_rows(plan.base, plan.folder(comparison.configurations.front(), plan.seeds.front()));
  pairs.push_back({"seeds", seeds});
  pairs.push_back({"options of all", (changed.empty() ? "" : changed + "; ") +
                                         "otherwise, but for the table below, as in --preset " + baseline.preset});
  return pairs;
}

}  // namespace

Json comparison_report_data(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  Json runs = Json::array(), machine = Json::object(), options = Json::array();
  std::vector<NamedInfo> first_runs;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const ConfigurationHistory& own = comparison.configurations[i];
    for (std::size_t k = 0; k < own.by_seed.size(); ++k) {
      runs.push_back(run_data(own.name, plan.seeds[k], own.by_seed[k]));
    }
    const RunInfo& info = comparison.infos[i].front();
    if (!info.machine.empty()) machine = info.machine;
    first_runs.push_back({own.name, info});
  }
  const Json rows = settings(comparison, options);
  return {{"kind", "comparison"},
          {"scene", scene_name(plan.base.source_path)},
          {"seeds", plan.seeds},
          {"chunk", plan.chunk},
          {"held_out", first_runs.front().info.held_out},
          {"measures_half", comparison.configurations.front().config.train_test_exp},
          {"reading_s", plan.reading_s},
          {"output_s", comparison.output_s()},
          {"summary", comparison.summary},
          {"tables",
           {{"results", results_table(comparison.summary)},
            {"balancing", balancing_table(comparison.summary)},
            {"paper", paper_table(comparison.summary)}}},
          {"settings", rows},
          {"options", options},
          {"machine", machine},
          {"previews", previews_data(first_runs)},
          {"runs", runs}};
}

void write_comparison(const Comparison& comparison) {
  write_json_file(plan_path(comparison.plan.root()), to_json(comparison), 1);
  write_file(comparison.plan.root() / kComparisonReport, report_page(comparison_report_data(comparison)));
}

std::string describe_comparison(const Comparison& comparison) {
  const Json& summary = comparison.summary;
  const TextTable results = results_table(summary), balancing = balancing_table(summary), paper = paper_table(summary);
  std::string text = aligned_text(results);
  if (have_equal_lengths(summary) && summary["done"] > 0) {
    text += "time saved: share of " + summary["baseline"].get<std::string>() + "'s training time\n";
  }
  if (std::count(results[0].begin(), results[0].end(), kOneSeedLimit) > 0) {
    text += "one-seed limit: smaller differences may be chance, if times vary as turns do and PSNR by at most 0.2 dB\n";
  }
  if (!balancing.empty()) {
    text += "\n" + aligned_text(balancing) + "against the fastest kernel without load balancing, all else equal\n";
  }
  if (!paper.empty()) text += "\n" + aligned_text(paper);
  return text + "\ntimes do not include reading the scene (" + format_seconds(comparison.plan.reading_s, 0) +
         ") or evaluation, saving and checkpoints (" + format_seconds(comparison.output_s(), 0) + ")\n" +
         summary["verdict"].get<std::string>() + "\n";
}

}  // namespace b3dgs
