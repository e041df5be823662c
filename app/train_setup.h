// What `train` and `compare` share: signals, paths, and the folders that models go into.
#pragma once

#include <atomic>
#include <filesystem>
#include <string>

#include "model/model_folder.h"

namespace b3dgs {

/// The number of the signal that asked the program to stop, or 0.
const std::atomic<int>& stop_signal();

/// From now on the first SIGINT or SIGTERM asks for a checkpoint. Another one more than half a second later ends the
/// program at once.
void catch_stop_signals();

/// A path that stays right when a later command runs in another folder; an empty one stays empty.
void make_absolute(std::string& path);

/// Takes away what an earlier training left, so that none of it is taken for the new one's.
void remove_model(const ModelFolder& folder);

/// Takes a folder that was made for the model away again if nothing came to be in it.
class EmptyFolderGuard {
 public:
  explicit EmptyFolderGuard(const std::filesystem::path& folder);
  ~EmptyFolderGuard();
  EmptyFolderGuard(const EmptyFolderGuard&) = delete;
  EmptyFolderGuard& operator=(const EmptyFolderGuard&) = delete;

 private:
  std::filesystem::path folder_;
};

}  // namespace b3dgs
