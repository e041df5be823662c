// Stubs for colmap, ffmpeg and ffprobe: shell scripts that imitate the output of the programs.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"
#include "support/temp_dir.h"

namespace b3dgs::test {

/// While it exists, PATH begins with the stubs.
class FakePrograms {
 public:
  FakePrograms();
  ~FakePrograms();
  FakePrograms(const FakePrograms&) = delete;
  FakePrograms& operator=(const FakePrograms&) = delete;

  /// Sets the number of photographs in each model that the mapper writes. Without models, it fails like COLMAP.
  void set_models(const std::vector<int>& sizes) const;
  /// Sets the model that the mapper writes, with tracks.
  void set_model(const ColmapModel& model) const;
  /// Sets shell commands that the next calls of colmap run first, for example "exit 3". $1 is the command, such as
  /// mapper.
  void set_colmap_prelude(const std::string& commands) const;
  /// Selects the options of this version: "3.8" or "3.13".
  void set_colmap_version(const std::string& version) const;
  /// Adds a line to the help of COLMAP's commands.
  void add_colmap_help(const std::string& line) const;
  /// Adds a command to the list of COLMAP's help. `global_mapper` does what `mapper` does.
  void add_colmap_command(const std::string& command) const;
  /// Makes feature_extractor wait after each photograph from now on, so that it can be interrupted.
  void slow_down() const;
  /// Sets the grey images that ffmpeg decodes from any video, of side x side bytes each, and their number.
  void set_video(const std::string& bytes, int n_frames, int side) const;
  /// Hides the stub and the system's program from now on.
  void hide(const std::string& program) const;

  /// Returns the command lines of all calls except those that ask for help, one each.
  std::vector<std::string> calls() const;
  void forget_calls() const;

 private:
  TempDir folder_;
  std::string path_before_;
};

/// Writes small photographs of random colours, a.png, b.png, ...
void write_photographs(const std::filesystem::path& folder, int n, int width = 8, int height = 6);

}  // namespace b3dgs::test
