#include "compare/comparison.h"

#include <algorithm>

#include "compare/compare_results.h"
#include "compare/compare_summary.h"
#include "compare/compare_verdict.h"
#include "config/former_options.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "report/page_data.h"

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
          {"loading_ms", plan.loading_ms},
          {"given", plan.given},
          {"photographs", plan.photographs.n},
          {"overlap", plan.photographs.overlap},
          {"config", config_to_json(plan.base)}};
}

Json to_json(const Comparison& comparison) {
  Json json = {{"plan", to_json(comparison.plan)}, {"summary", to_json(comparison.summary)}};
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

/// Mean of a measure of quality over seeds, or "-".
std::string quality_cell(const ComparisonSummary& summary, std::size_t configuration, const std::string& measure,
                         const char* format) {
  const bool is_baseline = configuration == 0;
  const QualityDifference* const own = summary.compared[is_baseline ? 0 : configuration - 1].find_quality(measure);
  return own == nullptr ? "-" : print_to_string(format, (is_baseline ? own->baseline : own->ours).mean);
}

/// Training time, s: the mean over the seeds that have started.
double mean_seconds(const Comparison& comparison, std::size_t configuration) {
  const ComparisonSummary& summary = comparison.summary;
  double seconds = 0;
  for (std::size_t seed = 0; seed < summary.done_by_seed.size(); ++seed) {
    seconds += elapsed_at(comparison.configurations[configuration].by_seed[seed], summary.done_by_seed[seed]) /
               std::max(1, summary.seeds_started());
  }
  return seconds;
}

/// What was trained, how long that took and what came of it. Columns without content are left out: those of a kernel
/// switch if there was none, and the interval with one seed.
std::string summary_table(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  const auto some = [&](const auto& has) { return std::any_of(summary.compared.begin(), summary.compared.end(), has); };
  const bool has_switch = some([](const ComparedConfiguration& own) { return own.before.has_value(); });
  const bool has_interval = some([](const ComparedConfiguration& own) { return own.overall && own.overall->margin; });
  std::vector<std::vector<std::string>> rows{{"configuration", "training s", "time saved"}};
  if (has_interval) rows[0].emplace_back("95 % interval");
  rows[0].emplace_back("time");
  if (has_switch) rows[0].insert(rows[0].end(), {"before switch", "after switch"});
  rows[0].insert(rows[0].end(), {"PSNR dB", "PSNR", "SSIM", "Gaussians"});
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const ComparedConfiguration* const own = i == 0 ? nullptr : &summary.compared[i - 1];
    const auto share = [&](const auto& saved, const std::optional<double>& noise) {
      return saved ? format_percent(saved->mean) + format_noise(noise) : std::string("-");
    };
    const bool is_known = own != nullptr && own->overall;
    std::vector<std::string> row{comparison.configurations[i].name,
                                 print_to_string("%.2f", mean_seconds(comparison, i)),
                                 is_known ? share(own->overall, own->noise.overall) : "-"};
    if (has_interval) row.push_back(is_known && own->overall->margin ? interval_text(*own->overall) : "-");
    row.push_back(is_known ? time_word(*own->overall) : "-");
    if (has_switch) {
      row.push_back(own == nullptr ? "-" : share(own->before, own->noise.before));
      row.push_back(own == nullptr ? "-" : share(own->after, own->noise.after));
    }
    const QualityDifference* const psnr = own == nullptr ? nullptr : own->find_quality(kPsnrMeasure);
    row.insert(row.end(),
               {quality_cell(summary, i, kPsnrMeasure, "%.2f"), psnr == nullptr ? "-" : finding_word(psnr->gained),
                quality_cell(summary, i, "SSIM", "%.4f"), quality_cell(summary, i, "Gaussians", "%.0f")});
    rows.push_back(row);
  }
  return text_table(rows) + "time saved: share of " + summary.baseline + "'s training time, in total" +
         (has_switch ? " and before and after the first switch to another forward kernel\n" : "\n");
}

/// Explains loading_ms in a sentence.
std::string describe_loading(const Comparison& comparison) {
  std::string names;
  for (const Configuration& own : comparison.configurations) {
    if (measures_kernels(own.config)) names += (names.empty() ? "" : ", ") + own.name;
  }
  return detail::concat("the times of ", names, " include ", format_figure(comparison.plan.loading_ms),
                        " ms for loading the candidate kernels, which each process does once");
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

bool holds_comparison(const fs::path& root) {
  return fs::exists(plan_path(root));
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
    plan.chunk = own.at("chunk").get<int>();
    plan.reading_s = own.at("reading_s").get<double>();
    // Files of earlier versions lack some keys; their trainings had no --max_epochs.
    plan.has_repetition = own.value("noise", false);
    plan.loading_ms = own.value("loading_ms", 0.0);
    stored_config_from_json(plan.base, own.at("config"), path.string());
    plan.is_of_earlier_version = has_removed_options(own.at("config")) || !own.at("config").contains("lenses");
    plan.given = own.contains("given") ? present_options(own.at("given")) : config_to_json(plan.base);
    if (!own.contains("photographs")) plan.given.emplace("max_epochs", 0);
    plan.photographs = own.value("photographs", std::size_t{0});
    plan.photographs.overlap = own.value("overlap", plan.photographs.overlap);
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
      if (!measures_kernels(configuration.config)) continue;
      for (LogPoint& point : by_seed.back().points) point.elapsed_s += 1e-3 * plan.loading_ms;
    }
  }
  comparison.summary = summarize_comparison(comparison.configurations, plan.longest());
  return comparison;
}

namespace {

/// Options of several configurations.
struct ComparedOptions {
  std::string shared;         // those that all have, where they differ from the default values
  Json rows = Json::array();  // those in which configurations differ: the name, and a text for each configuration
};

ComparedOptions compare_options(const std::vector<ConfigurationHistory>& configurations) {
  std::vector<Json> all;
  all.reserve(configurations.size());
  for (const ConfigurationHistory& own : configurations) all.push_back(config_to_json(own.config));
  const Json defaults = config_to_json(TrainConfig{});
  Json shared = defaults;
  ComparedOptions compared;
  for (const auto& [name, first] : all.front().items()) {
    Json row = Json::array({name});
    bool differs = false;
    for (const Json& own : all) {
      row.push_back(option_value_text(own.at(name)));
      differs = differs || own.at(name) != first;
    }
    if (differs) {
      compared.rows.push_back(row);
    } else {
      shared[name] = first;
    }
  }
  compared.shared = changed_options(defaults, shared);
  return compared;
}

/// Pairs of name and text.
Json settings(const Comparison& comparison, const std::string& shared) {
  const ComparisonPlan& plan = comparison.plan;
  Json rows = scene_rows(plan.base, plan.folder(comparison.configurations.front(), plan.seeds.front()));
  std::string seeds;
  for (const std::int64_t seed : plan.seeds) seeds += (seeds.empty() ? "" : ", ") + std::to_string(seed);
  rows.push_back({"seeds", seeds});
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
    const ConfigurationHistory& own = comparison.configurations[i];
    for (std::size_t k = 0; k < own.by_seed.size(); ++k) {
      runs.push_back(run_data(own.name, plan.seeds[k], own.by_seed[k]));
    }
    const RunInfo& info = comparison.infos[i].front();
    if (!info.machine.empty()) machine = info.machine;
    first_runs.push_back({own.name, info});
  }
  const ComparedOptions options = compare_options(comparison.configurations);
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
          {"settings", settings(comparison, options.shared)},
          {"options", options.rows},
          {"machine", machine},
          {"previews", previews_data(first_runs)},
          {"runs", runs}};
}

void write_comparison(const Comparison& comparison) {
  write_json_file(plan_path(comparison.plan.root()), to_json(comparison), 1);
  write_file(comparison.plan.root() / kComparisonReport, report_page(comparison_report_data(comparison)));
}

std::string describe_comparison(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  if (!have_equal_lengths(summary.results)) return results_table(summary.results) + verdict(summary) + "\n";
  std::string text = summary_table(comparison);
  for (const ComparedConfiguration& compared : summary.compared) {
    const int n_seeds = static_cast<int>(compared.by_seed.size());
    if (!compared.before || compared.before->n == n_seeds) continue;
    text +=
        compared.name + ": times before and after the switch are known" + in_seeds(compared.before->n, n_seeds) + "\n";
  }
  for (const BalancingGain& gain : summary.balancing) text += gain.name + ": " + describe(gain) + "\n";
  if (!summary.repetition.empty()) text += describe_repetition(summary) + "\n";
  if (comparison.plan.loading_ms > 0) text += describe_loading(comparison) + "\n";
  return text + "times do not include reading the scene (" + format_seconds(comparison.plan.reading_s, 0) +
         ") or evaluation, saving and checkpoints (" + format_seconds(comparison.output_s(), 0) + ")\n" +
         verdict(summary) + "\n";
}

}  // namespace b3dgs
