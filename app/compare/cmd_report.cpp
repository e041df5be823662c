// b3dgs report: rewrites report.html of a training or a comparison from the files in its folder.
#include <filesystem>
#include <iostream>

#include "app/common/commands.h"
#include "app/common/single_option.h"
#include "app/compare/comparison.h"
#include "app/report/train_log_reader.h"
#include "app/report/train_report.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "core/options/command_line.h"

namespace b3dgs {
int run_report(const std::vector<std::string>& words) {
  CommandLine line("report", "Rewrite report.html of a training or a comparison.", "b3dgs report output/garden");
  SingleOption<std::string> option{{"folder", 'm', {"model_path"}}, "", "model folder or folder of a comparison"};
  line.add(option, "Report", {"folder"});
  if (!line.parse(words)) return 0;
  if (option.value.empty()) input_error("missing argument: FOLDER; usage: b3dgs report FOLDER");

  const std::filesystem::path folder = option.value;
  if (!std::filesystem::is_directory(folder)) {
    input_error(std::filesystem::exists(folder) ? "not a directory: " : "folder not found: ", folder.string(),
                " (expected the output folder of b3dgs train or b3dgs compare)");
  }
  const OwnFiles own_files(folder);
  if (holds_comparison(folder)) {
    const Comparison comparison = load_comparison(read_plan(folder));
    write_comparison(comparison);
    std::cout << describe_comparison(comparison) << "written: " << (folder / "report.html").string() << "\n";
    return 0;
  }
  const ModelFolder model(folder);
  if (!model.has_config()) {
    input_error("neither a model folder nor a comparison: ", folder.string(),
                " (expected config.json or compare.json); pass the folder that was given with -m");
  }
  if (read_train_log(model.log()).points.empty()) {
    input_error(model.log().string(), ": not found, or without iterations (expected the log of a training); no report ",
                "was written");
  }
  const std::filesystem::path report = write_train_report(model);
  std::cout << "written: " << report.string() << "\n";
  return 0;
}

}  // namespace b3dgs
