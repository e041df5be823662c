#include "scene/colmap/model_search.h"

#include <algorithm>
#include <optional>

#include "core/check.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct Candidate {
  fs::path folder;
  std::uint64_t n_images = 0;
};

// 2 before 10.
bool by_number_then_name(const fs::path& a, const fs::path& b) {
  const std::string left = a.filename().string(), right = b.filename().string();
  const auto is_number = [](const std::string& text) {
    return text.find_first_not_of("0123456789") == std::string::npos;
  };
  if (is_number(left) && is_number(right) && left.size() != right.size()) return left.size() < right.size();
  return left < right;
}

std::vector<fs::path> folders_to_search(const fs::path& source) {
  std::vector<fs::path> folders;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(source / "sparse", error)) {
    if (entry.is_directory(error)) folders.push_back(entry.path());
  }
  std::sort(folders.begin(), folders.end(), by_number_then_name);
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
    if (!fs::exists(source))
      input_error("scene folder not found: ", source.string(), " (expected images/ and sparse/0/)");
    input_error("scene is not a folder: ", source.string(), " (expected a folder with images/ and sparse/0/); ",
                "`b3dgs reconstruct PHOTOS|VIDEO SCENE` makes a scene");
  }
  std::vector<Candidate> candidates;
  for (const fs::path& folder : folders_to_search(source)) {
    if (colmap_format(folder)) candidates.push_back({folder, 0});
  }
  if (candidates.empty()) {
    input_error(
        source.string(), ": no COLMAP model found in sparse/0, sparse/N or sparse/ (expected cameras, images and ",
        "points3D, as .bin or .txt files), and no transforms.json or transforms_train.json; `b3dgs reconstruct ",
        "PHOTOS SCENE` makes a scene from photographs, or choose another folder with -s");
  }
  SparseModelFolder found;
  if (candidates.size() == 1) {
    found.folder = candidates.front().folder;
    found.format = *colmap_format(found.folder);
    return found;
  }
  for (Candidate& candidate : candidates) {
    try {
      candidate.n_images = count_colmap_images(candidate.folder);
    } catch (const InputError& error) {  // reading this model reports it again if no other one is valid
      found.notes.push_back(error.what());
    }
  }
  const auto best = std::max_element(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return a.n_images < b.n_images;  // the first of equals
  });
  found.folder = best->folder;
  found.format = *colmap_format(best->folder);
  std::string others;
  for (const Candidate& candidate : candidates) {
    if (candidate.folder == best->folder) continue;
    others += detail::concat(others.empty() ? "" : ", ", candidate.folder.lexically_relative(source).string(), " (",
                             candidate.n_images, ")");
  }
  found.notes.push_back(detail::concat(candidates.size(), " models: using ",
                                       best->folder.lexically_relative(source).string(),
                                       ", which has the most images (", best->n_images, "); ignoring ", others));
  return found;
}

}  // namespace b3dgs
