// The program colmap: its version, the names of its options in that version, its command lines, and the meaning of its
// output lines.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "app/reconstruct/program_log.h"
#include "app/reconstruct/reconstruct.h"

namespace b3dgs {

struct ColmapFolders {
  std::filesystem::path database;
  std::filesystem::path images;
  std::filesystem::path models;  // output of the mapper: one folder for each model
};

/// @throws InputError with the remedy if there is no colmap in PATH
void check_colmap_is_installed();

class ColmapProgram {
 public:
  /// Asks colmap for its version. @throws InputError, with the remedy, if it is not installed, does not run, does not
  /// know the camera model, or cannot use a GPU as requested
  ColmapProgram(const ReconstructOptions& options, ColmapFolders folders, ProgramLog& log);

  /// Returns the first lines of its help, such as "COLMAP 3.8 (... without CUDA)".
  const std::string& version() const { return version_; }

  /// Announces that the photographs are faces of panoramas, `n_faces` of each, one after the other. They are pinholes
  /// with these parameters, which COLMAP does not refine.
  void use_faces(const std::string& params, std::size_t n_faces);

  /// Extracts the features of the photographs listed in the file `list`, one per line. With `is_single_camera` they
  /// share one camera: `camera`, or a new one.
  std::vector<std::string> extract_command(const std::filesystem::path& list, bool is_single_camera,
                                           std::optional<std::size_t> camera);
  /// `matcher` is exhaustive or sequential.
  std::vector<std::string> match_command(const std::string& matcher, std::size_t n_photographs);
  /// Returns how many photographs are in a block of pairs of exhaustive matching.
  std::size_t pairs_block(std::size_t n_photographs);
  /// `mapper` is mapper or global_mapper.
  std::vector<std::string> map_command(const std::string& mapper);

  /// Returns whether this version has the command.
  bool has_command(const std::string& command) const { return commands_.count(command) > 0; }

 private:
  void check_options();
  std::string short_version() const;  // "COLMAP 3.8"
  std::vector<std::string> begin(const std::string& command) const;
  /// `stage`: "Extraction" or "Matching".
  void add_device(std::vector<std::string>& command, const std::string& stage);
  /// Adds words for the first of `names` that the command knows, or none if it knows none of them.
  void add(std::vector<std::string>& command, const std::vector<std::string>& names, const std::string& value);
  const std::set<std::string>& options_of(const std::string& command);
  bool uses_gpu() const;

  const ReconstructOptions& options_;
  ColmapFolders folders_;
  ProgramLog& log_;
  std::string version_;
  std::set<std::string> commands_;                      // and other words of its help
  std::map<std::string, std::set<std::string>> known_;  // options by command
  std::string face_params_;                             // empty: the photographs are not faces
  std::size_t n_faces_ = 1;
};

/// Returns options in the help text of a COLMAP command: the words that begin with two hyphens.
std::set<std::string> options_in_help(const std::vector<std::string>& lines);

struct ColmapStep {
  std::size_t done = 0;
  std::size_t total = 0;  // 0: not in the line
};

/// Returns the steps that a line reports, as versions 3.8 to 4.0 print them: "Processed file [3/50]", "Matching block
/// [1/4, 2/4] in 3.2s", "Matching image [3/50]", "Registering image #7 (12)". A block whose line has no time is about
/// to be matched, so `done` does not count it.
std::optional<ColmapStep> colmap_step(const std::string& line);

/// Returns the number of pairs in the first `n_blocks` blocks of exhaustive matching, or in all of them. COLMAP matches
/// each pair once, in one of the two blocks that hold it.
std::size_t pairs_in_blocks(std::size_t n_photographs, std::size_t block, std::size_t n_blocks);

/// Returns the number in "Camera: #3 - OPENCV", with which feature_extractor reports the camera of a photograph.
std::optional<std::size_t> colmap_camera(const std::string& line);

}  // namespace b3dgs
