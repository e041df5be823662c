// Which stages of a reconstruction are done, so that the next call does not repeat them.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// The stages in their order, with their settings, in a JSON file that each change rewrites.
class StageRecord {
 public:
  /// Reads the file. Without one, or if it is damaged, no stage is done.
  explicit StageRecord(std::filesystem::path file);

  /// Goes on to the next stage. True if it was finished by an earlier call with the same settings, and so was each
  /// stage before it. Otherwise the record of it and of all later stages is replaced: they have to be done again.
  /// `still_there`: whether its results exist; if not, it counts as not done.
  /// @throws IoError
  bool is_done(const std::string& stage, const nlohmann::ordered_json& settings, bool still_there);

  /// Whether an earlier call began the stage with the same settings, but did not finish it.
  bool was_begun() const { return was_begun_; }

  /// The text that the settings of a stage of an earlier call have for the key; "" if there is none.
  std::string earlier_text(const std::string& stage, const char* key) const;

  /// What the stage has noted; an empty object at first.
  const nlohmann::ordered_json& notes() const;
  /// @throws IoError
  void set_notes(const nlohmann::ordered_json& notes);

  /// The stage is done. @throws IoError
  void finish();

 private:
  void write() const;
  nlohmann::ordered_json& current() { return stages_.at(n_passed_ - 1); }

  std::filesystem::path file_;
  nlohmann::ordered_json stages_ = nlohmann::ordered_json::array();
  std::size_t n_passed_ = 0;
  bool was_begun_ = false;
};

/// Whether the file is such a record, of any version.
bool is_stage_record(const std::filesystem::path& file);

}  // namespace b3dgs
