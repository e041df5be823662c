// b3dgs report: rewrites report.html of a training or a comparison from the files in its folder.
#include <filesystem>
#include <iostream>

#include "app/tools/commands.h"
#include "compare/comparison.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "core/options/command_line.h"
#include "report/train_report.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct ReportOptions {
  std::string folder;
};

template <class Visitor>
void visit_fields(ReportOptions& c, Visitor&& field) {
  field(Option{"folder", 'm', {"model_path"}}, c.folder, Any{}, "model folder or folder of a comparison");
}

}  // namespace

int run_report(const std::vector<std::string>& words) {
  CommandLine line("report", "Rewrite report.html of a training or a comparison.", "b3dgs report output/garden");
  ReportOptions options;
  line.add(options, "Report", {"folder"});
  if (!line.parse(words)) return 0;
  if (options.folder.empty()) input_error("missing argument: FOLDER; usage: b3dgs report FOLDER");

  const fs::path folder = options.folder;
  if (!fs::exists(folder)) input_error("folder not found: ", folder.string());
  if (!fs::is_directory(folder)) {
    input_error("not a directory: ", folder.string(), " (expected the output folder of b3dgs train or b3dgs compare)");
  }
  const OwnFiles own_files(folder);
  if (holds_comparison(folder)) {
    const Comparison comparison = load_comparison(read_plan(folder));
    write_comparison(comparison);
    std::cout << describe_comparison(comparison);
    std::cout << "written: " << (folder / "report.html").string() << "\n";
  } else {
    if (!ModelFolder(folder).has_config()) {
      input_error("neither a model folder nor a comparison: ", folder.string(),
                  " (expected config.json or compare.json); pass the folder that was given with -m");
    }
    const fs::path report = write_train_report(ModelFolder(folder));
    std::cout << "written: " << report.string() << "\n";
  }
  return 0;
}

}  // namespace b3dgs
