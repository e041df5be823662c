// From the names in a COLMAP model to files on disk.
#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

namespace b3dgs {

class ImageFolder {
 public:
  /// `images` is the folder below `source`. Where "images_4" is missing but "images" is there, that one stands in with
  /// divisor() 4. @throws InputError if no folder can stand in for a missing one.
  ImageFolder(const std::filesystem::path& source, const std::string& images);

  const std::filesystem::path& folder() const { return folder_; }
  int divisor() const { return divisor_; }
  /// What was replaced, for the user; "" if nothing.
  const std::string& note() const { return note_; }

  /// The file that a registered name means, empty if there is none: the name below the folder, without a leading
  /// "images/", or below the scene folder.
  std::filesystem::path find(const std::string& name) const;

  /// A file that is probably meant, empty if none or several are: the same name with another extension or case, or the
  /// last part of the name where either the name or the file has no sub-folder.
  std::filesystem::path find_similar(const std::string& name) const;

  /// Image files in the folder that are not among `used`.
  std::size_t count_others(const std::set<std::filesystem::path>& used) const;

 private:
  using Index = std::unordered_map<std::string, std::filesystem::path>;  // an empty path: several files have the key

  void list_files();
  std::vector<std::string> names_below_folder(const std::string& name) const;

  std::filesystem::path source_, folder_;
  std::string images_;
  int divisor_ = 1;
  std::string note_;
  std::vector<std::filesystem::path> files_;
  Index by_path_, by_name_;  // lower case, without extension
};

}  // namespace b3dgs
