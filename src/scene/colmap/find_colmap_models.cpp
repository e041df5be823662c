// Finds the COLMAP model of a scene folder.
#include <algorithm>
#include <utility>

#include "core/check.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> folders_to_search(const fs::path& source) {
  std::vector<fs::path> folders;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(source / "sparse", error)) {
    if (entry.is_directory(error)) folders.push_back(entry.path());
  }
  std::sort(folders.begin(), folders.end(), [](const fs::path& a, const fs::path& b) {  // 2 before 10
    const std::string left = a.filename().string(), right = b.filename().string();
    return std::pair(left.size(), left) < std::pair(right.size(), right);
  });
  folders.push_back(source / "sparse");
  folders.push_back(source);
  return folders;
}

}  // namespace

bool has_model_folder(const fs::path& source) {
  const std::vector<fs::path> folders = folders_to_search(source);
  return std::any_of(folders.begin(), folders.end(), [](const fs::path& folder) { return colmap_format(folder); });
}

SparseModelFolder find_model_folder(const fs::path& source) {
  if (!fs::is_directory(source)) {
    if (!fs::exists(source)) {
      input_error("scene folder not found: ", source.string(), " (expected images/ and sparse/0/)");
    }
    input_error("scene is not a folder: ", source.string(), " (expected a folder with images/ and sparse/0/); ",
                "`b3dgs reconstruct PHOTOS|VIDEO SCENE` makes a scene");
  }
  std::vector<fs::path> folders = folders_to_search(source);
  folders.erase(std::remove_if(folders.begin(), folders.end(), [](const fs::path& f) { return !colmap_format(f); }),
                folders.end());
  if (folders.empty()) {
    input_error(
        source.string(), ": no COLMAP model found in sparse/0, sparse/N or sparse/ (expected cameras, images and ",
        "points3D, as .bin or .txt files), and no transforms.json or transforms_train.json; `b3dgs reconstruct ",
        "PHOTOS SCENE` makes a scene from photographs, or choose another folder with -s");
  }
  if (folders.size() == 1) return {folders[0], {}};
  std::vector<std::string> notes;
  std::vector<std::uint64_t> n_images(folders.size());
  for (std::size_t i = 0; i < folders.size(); ++i) {
    try {
      n_images[i] = count_colmap_images(folders[i]);
    } catch (const InputError& error) {  // if no other model is valid, reading this one reports it again
      notes.push_back(error.what());
    }
  }
  const auto best = static_cast<std::size_t>(std::max_element(n_images.begin(), n_images.end()) - n_images.begin());
  const auto name = [&](std::size_t i) { return folders[i].lexically_relative(source).string(); };
  std::string others;
  for (std::size_t i = 0; i < folders.size(); ++i) {
    if (i != best) others += detail::concat(others.empty() ? "" : ", ", name(i), " (", n_images[i], ")");
  }
  notes.push_back(detail::concat(folders.size(), " models: using ", name(best), ", which has the most images (",
                                 n_images[best], "); ignoring ", others));
  return {folders[best], std::move(notes)};
}

}  // namespace b3dgs
