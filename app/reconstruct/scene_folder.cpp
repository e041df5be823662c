#include "app/reconstruct/scene_folder.h"

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <string>
#include <system_error>
#include <utility>

#include "app/reconstruct/stage_record.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns whether this is a file of this program that exists only while it writes.
bool is_lock_or_temporary(const fs::path& path) {
  return path.filename().string().rfind(".b3dgs-", 0) == 0;
}

/// Returns all files and links at the path and below it.
std::vector<fs::path> files_at(const fs::path& path) {
  std::error_code error;
  if (!fs::is_directory(fs::symlink_status(path, error))) {
    return is_taken(path) ? std::vector<fs::path>{path} : std::vector<fs::path>{};
  }
  std::vector<fs::path> files;
  for (fs::recursive_directory_iterator it(path, error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    if (!fs::is_directory(it->symlink_status(ignored))) files.push_back(it->path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

std::vector<fs::path> database_files(const fs::path& database) {
  const std::string base = database.string();
  return {base, base + "-wal", base + "-shm", base + "-journal"};
}

bool is_taken(const fs::path& path) {
  std::error_code error;
  return fs::exists(fs::symlink_status(path, error));
}

bool holds_files(const fs::path& folder) {
  std::error_code error;
  return fs::is_directory(folder, error) && fs::directory_iterator(folder, error) != fs::directory_iterator();
}

ScenePlaces::ScenePlaces(const fs::path& scene)
    : root(scene),
      images(scene / "images"),
      sparse(scene / "sparse"),
      log(scene / "reconstruct.log"),
      work(scene / "reconstruct"),
      record(work / "stages.json"),
      database(work / "database.db"),
      frames(work / "frames"),
      faces(work / "faces"),
      models(work / "models"),
      ordered(work / "sparse") {}

void check_work_folder(const ScenePlaces& places) {
  if (is_stage_record(places.record)) return;
  OwnFiles own(places.root);
  for (const fs::path& file : files_at(real_path(places.work))) {
    if (own.is_own(file) || is_lock_or_temporary(file)) continue;
    input_error(places.work.string(), ": expected no other files here than those of an earlier call, found ",
                file.filename().string(), "; move or rename what is there, or choose another scene folder");
  }
}

SceneFolder::SceneFolder(const ScenePlaces& places, const WarnFn& warn)
    : places_(places), warn_(warn), lock_(places.root, "scene folder") {
  OwnFiles::set_reporter(warn_);
  // Scenes of earlier versions have no list of own files. Without these two, the scene could not be continued.
  if (!own().is_own(places_.record) && is_stage_record(places_.record)) {
    own().add(places_.record);
    if (!own().is_own(places_.log)) own().add(places_.log, /*is_growing=*/true);
  }
}

SceneFolder::~SceneFolder() {
  own().add(places_.log, /*is_growing=*/true);  // with its current size, because a shorter one is another file
  OwnFiles::set_reporter({});
}

OwnFiles& SceneFolder::own() const {
  OwnFiles* own = OwnFiles::of(places_.root / "file");
  B3DGS_CHECK(own != nullptr, "no list of own files for ", places_.root.string());
  return *own;
}

void SceneFolder::add(const fs::path& path) {
  for (const fs::path& file : files_at(path)) {
    if (!own().is_own(file)) own().add(file);
  }
}

bool SceneFolder::has_others(const fs::path& path) const {
  const std::vector<fs::path> files = files_at(path);
  return std::any_of(files.begin(), files.end(), [&](const fs::path& file) { return !own().is_own(file); });
}

void SceneFolder::clear(const fs::path& path) {
  own().remove(path);
  move_aside(path);
}

void SceneFolder::clear_database() {
  const fs::path& database = places_.database;
  const std::vector<fs::path> files = database_files(database);
  const auto is_users = [&](const fs::path& file) { return is_taken(file) && !own().is_own(file); };
  if (std::none_of(files.begin(), files.end(), is_users)) {
    for (const fs::path& file : files) own().remove(file);
  } else {
    std::vector<fs::path> free = database_files(previous_name(database));
    for (int i = 3; std::any_of(free.begin(), free.end(), is_taken); ++i) {
      free = database_files(database.string() + ".previous." + std::to_string(i));
    }
    for (std::size_t i = 0; i < files.size(); ++i) {
      if (is_taken(files[i])) own().move(files[i], free[i]);
    }
    warn_(database.string() + " was changed since by another program or an interruption; it is kept as " +
          free[0].filename().string());
  }
  if (is_taken(database)) io_error("cannot remove ", database.string());
}

void SceneFolder::move_aside(const fs::path& path, const std::string& reason) {
  if (!is_taken(path)) return;
  std::vector<fs::path> others;
  for (const fs::path& file : files_at(path)) {
    if (!own().is_own(file)) others.push_back(file);
  }
  const fs::path free = previous_name(path);
  own().move(path, free);
  if (others.empty() && reason.empty()) return;
  std::string line = reason.empty() ? "" : reason + ": ";
  line += path.string() + " is now " + free.filename().string();
  if (!others.empty()) {
    line += detail::concat(", with ", others.size(), others.size() == 1 ? " file" : " files",
                           " that this program did not write, or that changed since: ");
    const fs::path name = others[0].lexically_relative(path);
    line += (name == "." ? path.filename() : name).string() + (others.size() > 1 ? ", ..." : "");
  }
  warn_(detail::one_line(line));
}

std::size_t order_models(const fs::path& from, const fs::path& to) {
  std::vector<std::pair<std::uint64_t, fs::path>> models;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(from, error)) {
    if (!entry.is_directory(error) || !colmap_format(entry.path())) continue;
    try {
      models.emplace_back(count_colmap_images(entry.path()), entry.path());
    } catch (const InputError&) {
      continue;  // truncated, for example by a full disk; the log has COLMAP's own message
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

}  // namespace b3dgs
