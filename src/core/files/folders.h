// Locking, removing and temporary folders.
#pragma once

#include <filesystem>
#include <optional>

#include "core/descriptor.h"
#include "core/files/own_files.h"
#include "core/stop_signals.h"

namespace b3dgs {

/// Ensures that only one process writes into a folder, such as a training into its model folder. The system releases
/// the lock when the process ends, even if it crashes.
class FolderLock {
 public:
  /// Creates the folder if it is missing, locks it, and removes temporary files that killed processes left in it. Does
  /// nothing else on a file system without locks. The record of the program's own files (own_files.h) is kept
  /// meanwhile. A folder that was created, and stays empty, is removed at the end.
  /// `kind`: of folder, for errors. @throws InputError naming the process that holds the lock; IoError if the folder
  /// cannot be written to
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

/// Removes a file or a folder with its content. Symbolic links are removed, not followed. True if nothing is left,
/// including if there was nothing; else errno has the reason. A replacement for std::filesystem::remove_all: LibTorch
/// of the Python packages contains parts of a C++ standard library, and when it is loaded, remove_all resolves to a
/// broken copy in it and crashes.
bool remove_tree(const std::filesystem::path& path);

/// A new folder for intermediate files inside another one, with a name that nothing has; removed with its content at
/// the end of the scope, or by end_by_signal().
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
