#include "config/presets.h"

#include "config/option_layers.h"
#include "config/train_options.h"

namespace b3dgs {

const std::vector<OptionRow>& presets() {
  static const std::vector<OptionRow> kPresets{
      {"inria", "the options of the original 3DGS code, for comparison", nlohmann::ordered_json::object()},
      // fast and quality repeat max_epochs, because the scaling of the schedule would reduce it.
      {"fast",
       "a first look, in a fifth of the iterations of best",
       {{"strategy", "budget"},
        {"iterations", 6000},
        {"max_epochs", 400},
        {"lr_decay_from_epoch", 0},
        {"gaussians_per_pixel", 0.8},
        {"prune_weight", 0.01},
        {"score_views", 10},
        {"scaling_lr", 0.02},
        {"opacity_reg", 0.002},
        {"scale_reg", 0.003},
        {"coarse_scale", 4},
        {"coarse_until", 2400}}},
      {"quality",
       "with 100 photographs or more, three fifths of the Gaussians of best",
       {{"strategy", "budget"}, {"iterations", 24000}, {"max_epochs", 400}}},
      {"best",
       "the best picture of 100 photographs or more",
       {{"strategy", "budget"}, {"iterations", 30000}, {"gaussians_per_pixel", 2.4}, {"prune_weight", 0.01}}},
  };
  return kPresets;
}

const std::vector<OptionRow>& strategy_defaults() {
  static const std::vector<OptionRow> kStrategyDefaults{
      // The schedule of preset inria x 0.9, with growth during the first five sixths of it.
      {"mcmc",
       "",
       {{"iterations", 27000},
        {"position_lr_max_steps", 27000},
        {"densify_from_iter", 450},
        {"densify_until_iter", 22500},
        {"densification_interval", 90},
        {"sh_increase_interval", 900},
        {"coarse_until", 13500},
        {"max_gaussians", 1000000},
        {"opacity_lr", 0.05},
        {"opacity_reg", 0.01},
        {"scale_reg", 0.01},
        {"lr_final_scale", 0.3},
        {"lr_decay_from_iter", 13500}}},
      {"budget",
       "",
       {{"iterations", 30000},  // as in inria, but here --iterations scales the schedule
        {"max_epochs", 400},
        {"densify_until_iter", 20000},
        {"densification_interval", 300},
        {"gaussians_per_pixel", 1.5},
        {"position_lr_final", 1.6e-5},
        {"opacity_lr", 0.05},
        {"feature_lr", 0.005},
        {"feature_rest_divisor", 10},
        {"rotation_lr", 0.002},
        {"opacity_reg", 0.005},
        {"scale_reg", 0.01},
        {"sh_decay", 0.003},
        {"lr_final_scale", 0.1},
        {"lr_decay_from_iter", 20000},
        {"lr_decay_from_epoch", 100}}},
  };
  return kStrategyDefaults;
}

namespace {

/// Returns "  fast        a first look: strategy budget, iterations 6000, ...", in lines.
std::string help_entry(const OptionRow& row) {
  std::vector<std::string> parts;
  for (const auto& [name, value] : row.values.items()) parts.push_back(name + " " + option_value_text(value));
  if (parts.empty()) parts.emplace_back();
  const std::string summary = row.summary;
  parts[0] = summary + (summary.empty() || row.values.empty() ? "" : ": ") + parts[0];
  std::string text;
  for (const std::string& line : wrapped_list(std::string("  ") + row.name, parts, /*columns=*/110))
    text += line + "\n";
  return text;
}

/// Returns a row for each option that a column names, in the order of the field list. The first column, `others`, has
/// the values that apply where a cell is empty.
std::string table(const std::string& others, const std::vector<OptionRow>& columns) {
  std::string head = "| Option | " + others + " |", rule = "|---|---|", rows;
  for (const OptionRow& column : columns) {
    if (column.values.empty()) continue;
    head += std::string(" `") + column.name + "` |";
    rule += "---|";
  }
  const nlohmann::ordered_json defaults = config_to_json(TrainConfig{});
  for (const auto& [name, value] : defaults.items()) {
    std::string cells;
    bool is_named = false;
    for (const OptionRow& column : columns) {
      if (column.values.empty()) continue;
      const auto own = column.values.find(name);
      const bool has_value = own != column.values.end();
      is_named = is_named || has_value;
      cells += has_value ? " " + option_value_text(*own) + " |" : " |";
    }
    if (is_named) rows += "| `--" + name + "` | " + option_value_text(value) + " |" + cells + "\n";
  }
  return head + "\n" + rule + "\n" + rows;
}

}  // namespace

std::string presets_help() {
  std::string text = "Values of --preset (default: ";
  text += std::string(kDefaultPreset) + "; if another --strategy than its own is given: " + kPresetNames[0] + "):\n";
  for (const OptionRow& row : presets()) text += help_entry(row);
  text += "\nValues of --strategy:\n";
  for (const OptionRow& row : strategy_defaults()) text += help_entry(row);
  return text;
}

std::string presets_markdown() {
  std::string text =
      "## Presets and strategies\n\nWhere several of the following set an option, the last in this order wins:\n"
      "`--preset inria`, the strategy in use, `--preset`, `--config FILE`, the command line. See\n"
      "[recipes.md](recipes.md).\n\n";
  text +=
      std::string("The default is `--preset ") + kDefaultPreset +
      "`, or, where another `--strategy` than its own is given,\n`--preset " + kPresetNames[0] +
      "`. The tables above show defaults without `--preset` and `--strategy`. Where a\ncell below is empty, the "
      "value of the strategy applies or, if it has none, that of `inria`.\n`--iterations`, of a "
      "preset or given by you, scales the\nschedule set by what comes before it in this order. With `--preset inria "
      "--strategy default`, the\n`--iterations` that you give scales nothing.\n\n"
      "### Values of `--preset`\n\n";
  for (const OptionRow& row : presets()) text += std::string("- `") + row.name + "`: " + row.summary + "\n";
  return text + "\n" + table("`inria`", presets()) + "\n### Values of `--strategy`\n\n" +
         table("`default`", strategy_defaults());
}

}  // namespace b3dgs
