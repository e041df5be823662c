#include "app/train/replaced_model.h"

#include <sys/stat.h>

#include "app/report/page_data.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns all files that a training, its evaluation and its report write into a model folder.
std::vector<fs::path> parts_of(const ModelFolder& folder) {
  const fs::path& root = folder.root();
  std::vector<fs::path> parts{root / "point_cloud", root / "checkpoints", report_folder(folder)};
  for (const fs::path& set : folder.image_sets()) parts.push_back(set);
  for (const fs::path& results : folder.results()) parts.push_back(results);
  for (const char* name : {"train.jsonl", "poses.json", "exposure.json", "report.html", "input.ply", "cameras.json",
                           "photographs.json", "cfg_args", "config.json", "training.json"}) {
    parts.push_back(root / name);
  }
  return parts;
}

/// Moves PLYs, checkpoints and results that would be mistaken for a part of the new model to a new folder in
/// set_aside/.
void move_remains(const ModelFolder& folder, OwnFiles& own, StatusLine& status) {
  const auto results = folder.results();
  std::vector<fs::path> remains(results.begin(), results.end());
  for (const int iteration : folder.ply_iterations()) remains.push_back(folder.ply(iteration));
  for (const int iteration : folder.checkpoint_iterations()) remains.push_back(folder.checkpoint(iteration));
  fs::path aside;
  for (int i = 1; aside.empty() || fs::exists(aside); ++i) {
    aside = folder.root() / "set_aside" / ("replaced_" + std::to_string(i));
  }
  for (const fs::path& file : remains) {
    if (!fs::exists(file)) continue;
    const fs::path to = aside / file.lexically_relative(folder.root());
    create_folder(to.parent_path());
    own.move(file, to);
  }
  if (!fs::exists(aside)) return;
  status.warn("files of the model that is replaced were not written by b3dgs, or changed since; they are now in " +
              aside.string());
}

/// Moves the program's own files in `from` to the same relative paths below `to`.
void move_own(const fs::path& from, const fs::path& to, OwnFiles& own) {
  if (fs::is_symlink(from) || !fs::is_directory(from)) {
    if (!own.is_own(from)) return;
    create_folder(to.parent_path());
    own.move(from, to);
    return;
  }
  std::vector<fs::path> inside;
  for (const fs::directory_entry& entry : fs::directory_iterator(from)) inside.push_back(entry.path());
  for (const fs::path& path : inside) move_own(path, to / path.filename(), own);
  std::error_code error;  // ignored: other files are in it
  fs::remove(from, error);
}

/// Returns whether the model has the PLY of its training's last iteration.
bool is_finished(const ModelFolder& folder) {
  const std::vector<int> saved = folder.ply_iterations();
  if (saved.empty()) return false;
  try {
    return saved.back() >= folder.read_config().iterations;
  } catch (const InputError&) {
    return true;  // a PLY without more information
  }
}

constexpr const char *kReplaced = "replaced", *kMoving = "replaced.moving";

}  // namespace

void require_movable(const ModelFolder& folder) {
  struct stat root {};
  if (::stat(folder.root().c_str(), &root) != 0) return;
  for (const char* part : {"point_cloud", "checkpoints", "report"}) {
    struct stat own {};
    const fs::path path = folder.root() / part;
    if (::lstat(path.c_str(), &own) != 0 || (!S_ISLNK(own.st_mode) && own.st_dev == root.st_dev)) continue;
    input_error(path.string(), ": is a link, or on another disk than ", folder.root().string(),
                ", so that --overwrite cannot keep the earlier model until the new one is complete; move the model ",
                "elsewhere, or choose another folder with -m");
  }
}

void put_model_aside(const ModelFolder& folder, StatusLine& status) {
  require_movable(folder);
  OwnFiles own(folder.root());
  // The folder has another name until it is complete, so that an interrupted move continues in the next call.
  const fs::path moving = folder.root() / kMoving, replaced = folder.root() / kReplaced;
  if (!fs::exists(moving) && fs::exists(replaced) && !is_finished(folder)) {
    for (const fs::path& part : parts_of(folder)) own.remove(part);
  } else {
    if (!fs::exists(moving)) own.remove(replaced);
    for (const fs::path& part : parts_of(folder)) move_own(part, moving / part.filename(), own);
    move_own(moving, replaced, own);
  }
  move_remains(folder, own, status);
}

void put_aside(const fs::path& folder, const std::vector<fs::path>& parts) {
  OwnFiles own(folder);
  for (const fs::path& part : parts) {
    const fs::path to = folder / kReplaced / part.filename();
    if (!fs::exists(to)) move_own(part, to, own);
  }
}

void drop_replaced_model(const fs::path& folder) {
  OwnFiles own(folder);
  for (const char* kept : {kReplaced, kMoving}) own.remove(folder / kept);
}

}  // namespace b3dgs
