// The program colmap: which version it is, what its options are called there, its command lines, and what the lines
// that it prints say.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "reconstruct/program_log.h"
#include "reconstruct/reconstruct.h"

namespace b3dgs {

struct ColmapFolders {
  std::filesystem::path database;
  std::filesystem::path images;
  std::filesystem::path models;  // the mapper's output: one folder for each model
};

/// @throws InputError if there is no colmap in PATH, with the remedy
void check_colmap_is_installed();

class ColmapProgram {
 public:
  /// Asks colmap for its version. @throws InputError if it is not installed, does not run, does not know the camera
  /// model, or cannot use a GPU as asked, with the remedy
  ColmapProgram(const ReconstructOptions& options, ColmapFolders folders, ProgramLog& log);

  /// The first lines of its help, such as "COLMAP 3.8 (... without CUDA)".
  const std::string& version() const { return version_; }

  /// The photographs are faces of panoramas, `n_faces` of each, one after the other: pinholes with these parameters,
  /// which COLMAP keeps.
  void use_faces(const std::string& params, std::size_t n_faces);

  /// Extracts the features of the photographs that the file `list` names, one per line. With `is_single_camera` they
  /// get one camera: `camera`, or a new one.
  std::vector<std::string> extract_command(const std::filesystem::path& list, bool is_single_camera,
                                           std::optional<std::size_t> camera);
  /// `matcher` is exhaustive or sequential.
  std::vector<std::string> match_command(const std::string& matcher, std::size_t n_photographs);
  std::vector<std::string> map_command();

 private:
  void check_options();
  std::string short_version() const;  // "COLMAP 3.8"
  std::vector<std::string> begin(const std::string& command) const;
  /// `stage`: "Extraction" or "Matching".
  void add_device(std::vector<std::string>& command, const std::string& stage);
  /// Words for the first of `names` that the command knows; none if it knows none of them.
  void add(std::vector<std::string>& command, const std::vector<std::string>& names, const std::string& value);
  const std::set<std::string>& options_of(const std::string& command);
  bool uses_gpu() const;

  const ReconstructOptions& options_;
  ColmapFolders folders_;
  ProgramLog& log_;
  std::string version_;
  std::map<std::string, std::set<std::string>> known_;  // options by command
  std::string face_params_;                             // empty: they are no faces
  std::size_t n_faces_ = 1;
};

/// Options in the help text of a COLMAP command: the words that begin with two hyphens.
std::set<std::string> options_in_help(const std::vector<std::string>& lines);

struct ColmapStep {
  std::size_t done = 0;
  std::size_t total = 0;  // 0: not in the line
};

/// Steps that a line reports, as versions 3.8 to 3.13 print them: "Processed file [3/50]", "Matching block [1/4, 2/4]",
/// "Matching image [3/50]", "Registering image #7 (12)". A block that is named is about to be matched or has been: done
/// counts it in both cases.
std::optional<ColmapStep> colmap_step(const std::string& line);

/// The number in "Camera: #3 - OPENCV", with which feature_extractor says which camera a photograph has got.
std::optional<std::size_t> colmap_camera(const std::string& line);

}  // namespace b3dgs
