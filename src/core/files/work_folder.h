// A folder for intermediate files.
#pragma once

#include <filesystem>

namespace b3dgs {

/// A new folder inside another one, with a name that nothing has; removed with its content at the end of the scope.
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
};

}  // namespace b3dgs
