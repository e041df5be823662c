// One training at a time in a model folder. The system releases the lock when its process ends, in whatever way.
#pragma once

#include <filesystem>

namespace b3dgs {

class FolderLock {
 public:
  /// Creates the folder if it is missing, locks it, and removes the unfinished files that killed processes left in it.
  /// On a file system that has no locks it goes without.
  /// @throws InputError naming the process that holds the lock, IoError if the folder cannot be written to
  explicit FolderLock(const std::filesystem::path& folder);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  std::filesystem::path path_;
  int file_ = -1;
};

}  // namespace b3dgs
