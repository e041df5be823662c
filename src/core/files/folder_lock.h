// Ensures that only one process writes into a folder, such as a training into its model folder. The system releases the
// lock when the process ends, even if it crashes.
#pragma once

#include <filesystem>
#include <optional>

#include "core/files/own_files.h"

namespace b3dgs {

class FolderLock {
 public:
  /// Creates the folder if it is missing, locks it, and removes temporary files that killed processes left in it. Does
  /// nothing else on a file system without locks. The record of the program's own files (own_files.h) is kept
  /// meanwhile.
  /// @throws InputError naming the process that holds the lock; IoError if the folder cannot be written to
  /// `kind` of folder, for the error.
  explicit FolderLock(const std::filesystem::path& folder, const char* kind = "model folder");
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  std::filesystem::path path_;
  int file_ = -1;
  std::optional<OwnFiles> own_files_;
};

}  // namespace b3dgs
