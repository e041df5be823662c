// The scene folder of a reconstruction: its paths, and which files in it may be removed.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/files/folders.h"

namespace b3dgs {

using WarnFn = std::function<void(const std::string& line)>;

/// Paths in the scene folder.
struct ScenePlaces {
  explicit ScenePlaces(const std::filesystem::path& scene);

  std::filesystem::path root, images, sparse, log;
  std::filesystem::path work, record, database;
  std::filesystem::path frames;   // frames of a video, until all are written
  std::filesystem::path faces;    // faces of panoramas
  std::filesystem::path models;   // models written by the mapper
  std::filesystem::path ordered;  // models by size, until they are accepted
};

/// @throws InputError if SCENE/reconstruct has files that this program has not written, because then it must not be
/// used
void check_work_folder(const ScenePlaces& places);

/// A scene folder in use. Removes and replaces only files that the program has written, according to own_files.h. Other
/// files stay, or are moved aside and named in a warning.
class SceneFolder {
 public:
  /// Locks the folder and makes it if it is missing. @throws InputError if another process has locked it; IoError
  SceneFolder(const ScenePlaces& places, const WarnFn& warn);
  ~SceneFolder();
  SceneFolder(const SceneFolder&) = delete;
  SceneFolder& operator=(const SceneFolder&) = delete;

  /// Registers a file that another program has written, or all files in a folder, as the program's own.
  void add(const std::filesystem::path& path);

  /// Returns whether there is a file of the user at the path or below it.
  bool has_others(const std::filesystem::path& path) const;

  /// Makes `path` free. Removes the program's own files, and moves the rest to PATH.previous. @throws IoError
  void clear(const std::filesystem::path& path);
  /// Does the same for the database_files(), which stay together.
  void clear_database();
  /// Moves anything at `path` to PATH.previous. Warns, with `reason` if there is one, and if there are files of the
  /// user. @throws IoError
  void move_aside(const std::filesystem::path& path, const std::string& reason = "");

  /// Returns the files that the program has written in the folder.
  OwnFiles& own() const;

 private:
  const ScenePlaces& places_;
  const WarnFn& warn_;
  FolderLock lock_;
};

/// Returns COLMAP's database, and the files beside it with data that SQLite has not yet written into it.
std::vector<std::filesystem::path> database_files(const std::filesystem::path& database);

/// Returns whether the path exists, also as a link that leads nowhere.
bool is_taken(const std::filesystem::path& path);

/// Returns whether the folder exists and is not empty.
bool holds_files(const std::filesystem::path& folder);

/// Moves the models in `from` to `to`/0, `to`/1, ..., starting with the one with the most registered photographs.
/// Folders without a readable model stay. @return the number of models
std::size_t order_models(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace b3dgs
