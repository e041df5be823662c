#include "report/run_info.h"

#include <algorithm>
#include <fstream>

#include "core/files/atomic_file.h"
#include "core/files/remove_tree.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json to_json(const RunInfo& record) {
  Json previews = Json::array();
  for (const Preview& preview : record.previews) {
    previews.push_back({{"view", preview.view},
                        {"psnr", preview.psnr},
                        {"truth", preview.truth.filename().string()},
                        {"render", preview.render.filename().string()}});
  }
  return {{"iteration", record.iteration}, {"reading_s", record.reading_s}, {"output_s", record.output_s},
          {"machine", record.machine},     {"held_out", record.held_out},   {"previews", previews}};
}

}  // namespace

fs::path report_folder(const ModelFolder& folder) {
  return folder.root() / "report";
}

void write_run_info(const RunInfo& record, const ModelFolder& folder) {
  write_file(report_folder(folder) / "run.json",
             to_json(record).dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

RunInfo read_run_info(const ModelFolder& folder) {
  std::ifstream file(report_folder(folder) / "run.json");
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  RunInfo record;
  if (!json.is_object()) return record;
  try {
    record.machine = json.value("machine", Json::object());
    record.reading_s = json.value("reading_s", 0.0);
    record.output_s = json.value("output_s", 0.0);
    record.iteration = json.value("iteration", 0);
    record.held_out = json.value("held_out", false);
    for (const Json& preview : json.value("previews", Json::array())) {
      record.previews.push_back({preview.at("view"), preview.value("psnr", 0.0),
                                 report_folder(folder) / preview.at("truth").get<std::string>(),
                                 report_folder(folder) / preview.at("render").get<std::string>()});
    }
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return record;
}

void remove_run_info(const ModelFolder& folder) {
  remove_tree(report_folder(folder));
}

}  // namespace b3dgs
