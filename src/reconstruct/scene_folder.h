// The scene folder of a reconstruction: what is where, and what in it may be removed.
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

/// Places in the scene folder.
struct ScenePlaces {
  explicit ScenePlaces(const std::filesystem::path& scene);

  std::filesystem::path root, images, sparse, log;
  std::filesystem::path work, record, database;
  std::filesystem::path frames;   // of a video, until all are written
  std::filesystem::path faces;    // of panoramas
  std::filesystem::path models;   // as the mapper writes them
  std::filesystem::path ordered;  // by size, until they are accepted
};

/// @throws InputError if SCENE/reconstruct has files that this program has not written: it may then not be used
void check_work_folder(const ScenePlaces& places);

/// A scene folder in use. Removes and replaces only files that the program has written, as own_files.h records them;
/// others stay, or are moved aside and named in a warning.
class SceneFolder {
 public:
  /// Locks the folder and makes it if it is missing. @throws InputError if another process holds it; IoError
  SceneFolder(const ScenePlaces& places, const WarnFn& warn);
  ~SceneFolder();
  SceneFolder(const SceneFolder&) = delete;
  SceneFolder& operator=(const SceneFolder&) = delete;

  /// Records a file that another program has written, or all files in a folder.
  void add(const std::filesystem::path& path);

  /// Whether there is a file of the user's at the path or below it.
  bool has_others(const std::filesystem::path& path) const;

  /// Makes `path` free: removes what is the program's own, and moves the rest to PATH.previous. @throws IoError
  void clear(const std::filesystem::path& path);
  /// The same for the database_files(), which stay together.
  void clear_database();
  /// Moves what is at `path`, if there is something, to PATH.previous. Warns, with `reason` if there is one, and if
  /// there are files of the user's. @throws IoError
  void move_aside(const std::filesystem::path& path, const std::string& reason = "");

  /// What the program has written in the folder.
  OwnFiles& own() const;

 private:
  const ScenePlaces& places_;
  const WarnFn& warn_;
  FolderLock lock_;
};

/// COLMAP's database, and the files beside it with what SQLite has not yet written into it.
std::vector<std::filesystem::path> database_files(const std::filesystem::path& database);

/// Whether something is at the path, also a link that leads nowhere.
bool is_taken(const std::filesystem::path& path);

/// Whether the folder is there and not empty.
bool holds_files(const std::filesystem::path& folder);

/// Moves the models in `from` to `to`/0, `to`/1, ..., the one with the most registered photographs first. Folders that
/// hold no readable model stay. @return the number of models
std::size_t order_models(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace b3dgs
