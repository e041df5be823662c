#include "app/reconstruct/stage_record.h"

#include <optional>
#include <utility>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/json_file.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kVersion = 1;

bool is_stage(const Json& json) {
  return json.is_object() && json.contains("stage") && json["stage"].is_string() && json.contains("settings") &&
         json.contains("done") && json["done"].is_boolean() && json.contains("notes") && json["notes"].is_object();
}

/// Returns nothing if the file is not a stages.json of any version.
std::optional<Json> read_record(const std::filesystem::path& file) {
  Json json = read_json(file);
  if (!json.is_object() || !json.contains("version") || !json["version"].is_number_integer()) return std::nullopt;
  if (!json.contains("stages") || !json["stages"].is_array()) return std::nullopt;
  return json;
}

/// Earlier versions had a stage for each group of photographs: "features 0", "features 1", ... Adds such a stage to the
/// one of all groups. Returns false for other stages.
bool join_groups(Json& stages, const Json& stage) {
  if (stage["stage"].get<std::string>().rfind("features ", 0) != 0 || !stage["settings"].is_object()) return false;
  if (stages.empty() || stages.back()["stage"] != "features") {
    stages.push_back(
        {{"stage", "features"}, {"settings", stage["settings"]}, {"done", true}, {"notes", Json::object()}});
    for (const char* of_group : {"cameras", "photographs"}) stages.back()["settings"].erase(of_group);
    stages.back()["settings"]["groups"] = Json::array();
  }
  Json& all = stages.back();
  if (!all["settings"].is_object() || !all["settings"]["groups"].is_array()) return false;
  if (all["done"] == true && stage["done"] == false) {
    all["done"] = false;
    all["notes"] = stage["notes"];  // notes with the group's camera
    all["notes"]["groups"] = all["settings"]["groups"].size();
  }
  all["settings"]["groups"].push_back(stage["settings"].value("photographs", Json()));
  return true;
}

}  // namespace

StageRecord::StageRecord(std::filesystem::path file) : file_(std::move(file)) {
  const std::optional<Json> record = read_record(file_);
  if (!record || (*record)["version"] != kVersion) return;
  for (const Json& stage : (*record)["stages"]) {
    if (!is_stage(stage)) return;
    if (!join_groups(stages_, stage)) stages_.push_back(stage);
  }
}

bool StageRecord::is_done(const std::string& stage, const Json& settings, bool still_there) {
  const std::size_t here = n_passed_++;
  const bool is_same = here < stages_.size() && stages_[here]["stage"] == stage &&
                       dump_json(stages_[here]["settings"]) == dump_json(settings);
  if (is_same && stages_[here]["done"] == true && still_there) return true;
  was_begun_ = is_same && stages_[here]["done"] == false;
  Json notes = was_begun_ ? stages_[here]["notes"] : Json::object();
  while (stages_.size() > here) stages_.erase(stages_.size() - 1);
  stages_.push_back({{"stage", stage}, {"settings", settings}, {"done", false}, {"notes", std::move(notes)}});
  write();
  return false;
}

std::string StageRecord::earlier_text(const std::string& stage, const char* key) const {
  for (const Json& earlier : stages_) {
    if (earlier["stage"] != stage || !earlier["settings"].is_object()) continue;
    const auto value = earlier["settings"].find(key);
    if (value != earlier["settings"].end() && value->is_string()) return value->get<std::string>();
  }
  return "";
}

const Json& StageRecord::notes() const {
  B3DGS_CHECK(n_passed_ > 0, "no stage yet");
  return stages_.at(n_passed_ - 1).at("notes");
}

void StageRecord::set_notes(const Json& notes) {
  current()["notes"] = notes;
  write();
}

void StageRecord::finish() {
  current()["done"] = true;
  write();
}

void StageRecord::write() const {
  const Json json{{"version", kVersion}, {"stages", stages_}};
  write_file(file_, dump_json(json, 1) + "\n");
}

bool is_stage_record(const std::filesystem::path& file) {
  return read_record(file).has_value();
}

}  // namespace b3dgs
