#include "reconstruct/colmap_models.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {

namespace fs = std::filesystem;

std::size_t order_models(const fs::path& from, const fs::path& to) {
  std::vector<std::pair<std::uint64_t, fs::path>> models;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(from, error)) {
    if (!entry.is_directory(error) || !colmap_format(entry.path())) continue;
    try {
      models.emplace_back(count_colmap_images(entry.path()), entry.path());
    } catch (const InputError&) {
      continue;  // cut off, for example by a full disk; the log has COLMAP's own message
    }
  }
  std::sort(models.begin(), models.end(),
            [](const auto& a, const auto& b) { return a.first != b.first ? a.first > b.first : a.second < b.second; });
  if (models.empty()) return 0;
  create_folder(to);
  for (std::size_t i = 0; i < models.size(); ++i) {
    fs::rename(models[i].second, to / std::to_string(i), error);
    if (error) io_error("cannot move ", models[i].second.string(), " to ", to.string(), ": ", error.message());
  }
  return models.size();
}

fs::path free_name(const fs::path& path) {
  fs::path name = path;
  for (int i = 2; fs::exists(fs::symlink_status(name)); ++i) name = path.string() + "." + std::to_string(i);
  return name;
}

}  // namespace b3dgs
