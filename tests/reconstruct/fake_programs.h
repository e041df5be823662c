// Stand-ins for colmap, ffmpeg and ffprobe: shell scripts that print what the programs print.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"
#include "support/temp_dir.h"

namespace b3dgs::test {

/// While it exists, PATH begins with the stand-ins.
class FakePrograms {
 public:
  FakePrograms();
  ~FakePrograms();
  FakePrograms(const FakePrograms&) = delete;
  FakePrograms& operator=(const FakePrograms&) = delete;

  /// How many of the photographs each model that the mapper writes has. Without models, it fails as COLMAP does.
  void set_models(const std::vector<int>& sizes) const;
  /// The model that the mapper writes, with tracks.
  void set_model(const ColmapModel& model) const;
  /// Shell commands that the next calls of colmap run first, for example "exit 3"; $1 is the command, such as mapper.
  void set_colmap_prelude(const std::string& commands) const;
  /// The options of this version: "3.8" or "3.13".
  void set_colmap_version(const std::string& version) const;
  /// A line that the help of COLMAP's commands has from now on.
  void add_colmap_help(const std::string& line) const;
  /// feature_extractor waits after each photograph from now on, so that it can be interrupted.
  void slow_down() const;
  /// Grey images that ffmpeg decodes from any video, of side x side bytes each, and their number.
  void set_video(const std::string& bytes, int n_frames, int side) const;
  /// Neither this program nor those of the system can be found from now on.
  void hide(const std::string& program) const;

  /// Command lines of all calls that do something, one each: not those that ask for help.
  std::vector<std::string> calls() const;
  void forget_calls() const;

 private:
  TempDir folder_;
  std::string path_before_;
};

/// Small photographs of random colours, a.png, b.png, ...
void write_photographs(const std::filesystem::path& folder, int n, int width = 8, int height = 6);

}  // namespace b3dgs::test
