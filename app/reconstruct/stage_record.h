// The finished stages of a reconstruction, so that the next call does not repeat them.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// The stages in their order, with their settings, in a JSON file that is rewritten at each change.
class StageRecord {
 public:
  /// Reads the file. Without one, or if it is damaged, no stage is done.
  explicit StageRecord(std::filesystem::path file);

  /// Continues with the next stage. Returns true if an earlier call has finished it and each stage before it with the
  /// same settings. Otherwise, the entries of it and of all later stages are replaced, and they have to be done again.
  /// `still_there`: whether its results exist; if not, it counts as not done. @throws IoError
  bool is_done(const std::string& stage, const nlohmann::ordered_json& settings, bool still_there);

  /// Returns whether an earlier call began the stage with the same settings, but did not finish it.
  bool was_begun() const { return was_begun_; }

  /// Returns the text for the key in the settings of a stage of an earlier call, or "".
  std::string earlier_text(const std::string& stage, const char* key) const;

  /// Returns the notes of the stage, an empty object at first.
  const nlohmann::ordered_json& notes() const;
  /// @throws IoError
  void set_notes(const nlohmann::ordered_json& notes);

  /// Marks the stage as done. @throws IoError
  void finish();

 private:
  void write() const;
  nlohmann::ordered_json& current() { return stages_.at(n_passed_ - 1); }

  std::filesystem::path file_;
  nlohmann::ordered_json stages_ = nlohmann::ordered_json::array();
  std::size_t n_passed_ = 0;
  bool was_begun_ = false;
};

/// Returns whether the file is a stages.json, of any version.
bool is_stage_record(const std::filesystem::path& file);

}  // namespace b3dgs
