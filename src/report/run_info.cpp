#include "report/run_info.h"

#include <algorithm>
#include <fstream>

#include "core/files/atomic_file.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json to_json(const RunInfo& info) {
  Json previews = Json::array();
  for (const Preview& preview : info.previews) {
    previews.push_back({{"view", preview.view},
                        {"psnr", preview.psnr},
                        {"truth", preview.photograph.filename().string()},
                        {"render", preview.render.filename().string()}});
  }
  return {{"iteration", info.iteration}, {"reading_s", info.reading_s}, {"output_s", info.output_s},
          {"machine", info.machine},     {"held_out", info.held_out},   {"previews", previews}};
}

}  // namespace

fs::path report_folder(const ModelFolder& folder) {
  return folder.root() / "report";
}

void write_run_info(const RunInfo& info, const ModelFolder& folder) {
  write_file(report_folder(folder) / "run.json",
             to_json(info).dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

RunInfo read_run_info(const ModelFolder& folder) {
  std::ifstream file(report_folder(folder) / "run.json");
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  RunInfo info;
  if (!json.is_object()) return info;
  try {
    info.machine = json.value("machine", Json::object());
    info.reading_s = json.value("reading_s", 0.0);
    info.output_s = json.value("output_s", 0.0);
    info.iteration = json.value("iteration", 0);
    info.held_out = json.value("held_out", false);
    for (const Json& preview : json.value("previews", Json::array())) {
      info.previews.push_back({preview.at("view"), preview.value("psnr", 0.0),
                               report_folder(folder) / preview.at("truth").get<std::string>(),
                               report_folder(folder) / preview.at("render").get<std::string>()});
    }
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return info;
}

}  // namespace b3dgs
