// Locks, removes and makes temporary folders, and makes paths absolute.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/descriptor.h"
#include "core/files/own_files.h"
#include "core/stop_signals.h"

namespace b3dgs {

/// Ensures that only one process writes into a folder, such as a training into its model folder. The system releases
/// the lock when the process ends, even if it crashes.
class FolderLock {
 public:
  /// Creates the folder if it is missing, locks it, and removes temporary files that killed processes left in it. On a
  /// file system without locks, it does nothing else. Meanwhile, the program's own files are tracked (own_files.h). If
  /// the folder was created and stays empty, it is removed at the end. `kind` names the folder in errors.
  /// @throws InputError naming the process that has the lock, or IoError if the folder is not writable
  explicit FolderLock(const std::filesystem::path& folder, const char* kind = "model folder");
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  std::filesystem::path path_;
  bool is_new_ = false;  // the folder
  Descriptor file_;
  std::optional<OwnFiles> own_files_;
};

/// Makes a path independent of the working folder. An empty path stays empty.
void make_absolute(std::string& path);

/// Removes a file or a folder with its content. Symbolic links are removed, not followed. Returns true if nothing is
/// left, including if there was nothing. Otherwise errno has the reason. This replaces std::filesystem::remove_all,
/// because LibTorch of the Python packages contains parts of a C++ standard library. When it is loaded, remove_all
/// resolves to a broken copy in it and crashes.
bool remove_tree(const std::filesystem::path& path);

/// A new folder for intermediate files inside another one, with an unused name. It is removed with its content at the
/// end of the scope, or by end_by_signal().
class WorkFolder {
 public:
  /// @throws IoError
  explicit WorkFolder(const std::filesystem::path& parent);
  ~WorkFolder();
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  std::optional<RemovedBySignal> removed_by_signal_;
};

}  // namespace b3dgs
