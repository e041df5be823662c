#include "config/preset_help.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "config/option_layers.h"
#include "config/presets.h"

namespace b3dgs {
namespace {

/// "  fast        a short training: iterations 7000, ...", broken at blanks.
std::string help_entry(const OptionRow& row) {
  constexpr std::size_t kNameColumns = 12, kColumns = 110;
  std::string text = std::string("  ") + row.name;
  text += std::string(kNameColumns - std::min(kNameColumns - 1, text.size()), ' ') + row.summary;
  std::string line = text, done;
  const auto add = [&](const std::string& words) {
    if (line.size() + words.size() > kColumns) {
      done += line + "\n";
      line = std::string(kNameColumns - 1, ' ');
    }
    line += words;
  };
  for (std::size_t i = 0; i < row.values.size(); ++i) {
    line += i == 0 ? ":" : ",";
    add(std::string(" ") + row.values[i].name + " " + row.values[i].value);
  }
  return done + line + "\n";
}

const char* value_in(const OptionRow& row, const std::string& name) {
  const auto own =
      std::find_if(row.values.begin(), row.values.end(), [&](const OptionValue& value) { return value.name == name; });
  return own == row.values.end() ? "" : own->value;
}

/// A row for each option that a column names, in the order of the field list. The first column, `others`, has the
/// values that apply where a cell is empty.
std::string table(const std::string& others, const std::vector<OptionRow>& columns) {
  std::string head = "| Option | " + others + " |", rule = "|---|---|", rows;
  for (const OptionRow& column : columns) {
    if (column.values.empty()) continue;
    head += std::string(" `") + column.name + "` |";
    rule += "---|";
  }
  const TrainConfig defaults;
  visit_fields(defaults, [&](const Option& option, const auto& value, const auto&, const char*) {
    const std::string name(option.name);
    std::string cells;
    bool is_named = false;
    for (const OptionRow& column : columns) {
      if (column.values.empty()) continue;
      const char* const own = value_in(column, name);
      is_named = is_named || *own != '\0';
      cells += std::string(" ") + own + (*own == '\0' ? "|" : " |");
    }
    if (is_named) rows += "| `--" + name + "` | " + option_value_text(value) + " |" + cells + "\n";
  });
  return head + "\n" + rule + "\n" + rows;
}

}  // namespace

std::string presets_help() {
  std::string text = "Values of --preset (default: ";
  text += std::string(kDefaultPreset) + "; if another --strategy than its own is given: " + kPresetNames[0] + "):\n";
  for (const OptionRow& row : presets()) text += help_entry(row);
  std::string strategies;
  for (const OptionRow& row : strategy_defaults()) {
    if (!row.values.empty()) strategies += help_entry(row);
  }
  return text + (strategies.empty() ? "" : "\nValues of --strategy:\n" + strategies);
}

std::string presets_markdown() {
  std::string text =
      "## Presets and strategies\n\nIf several of these set an option, the last one wins: `--preset original`, the "
      "strategy in use,\n`--preset`, `--config FILE`, the command line. See [recipes.md](recipes.md).\n\n";
  text += std::string("The default is `--preset ") + kDefaultPreset +
          "`, or, where another `--strategy` than its own is given,\n`--preset " + kPresetNames[0] +
          "`. The tables above show defaults without `--preset` and `--strategy`. Where a\ncell below is empty, the "
          "value of the strategy applies or, if it has none, that of `original`.\n`--iterations` of a "
          "preset or of yours scales the schedule\nof the layers before it; yours does not scale that of `--preset "
          "original` with `--strategy default`.\n\n"
          "### Values of `--preset`\n\n";
  for (const OptionRow& row : presets()) text += std::string("- `") + row.name + "`: " + row.summary + "\n";
  return text + "\n" + table("`original`", presets()) + "\n### Values of `--strategy`\n\n" +
         table("`default`", strategy_defaults());
}

}  // namespace b3dgs
