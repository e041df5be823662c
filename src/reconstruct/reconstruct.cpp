#include "reconstruct/reconstruct.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/folder_lock.h"
#include "core/files/remove_tree.h"
#include "reconstruct/colmap_models.h"
#include "reconstruct/colmap_program.h"
#include "reconstruct/colmap_progress.h"
#include "reconstruct/photographs.h"
#include "reconstruct/program_log.h"
#include "reconstruct/stage_record.h"
#include "reconstruct/video_frames.h"
#include "scene/images/image_folder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kWarnBelow = 0.8;            // of the photographs registered
constexpr std::size_t kMostExhaustive = 300;  // photographs; pairs grow with the square
constexpr const char* kHowToPhotograph =
    "photograph again with two thirds of overlap between neighbours, sharp, from many places, with the same zoom";

bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}

bool holds_files(const fs::path& folder) {
  std::error_code error;
  return fs::is_directory(folder, error) && fs::directory_iterator(folder, error) != fs::directory_iterator();
}

void move_folder(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::rename(from, to, error);
  if (error) io_error("cannot move ", from.string(), " to ", to.string(), ": ", error.message());
}

/// Removes what an earlier call has left in the working folder.
void remove_own(const fs::path& path) {
  if (!remove_tree(path)) io_error("cannot remove ", path.string());
}

/// Places in the scene folder.
struct SceneFolders {
  explicit SceneFolders(const fs::path& scene)
      : root(scene),
        images(scene / "images"),
        sparse(scene / "sparse"),
        work(scene / "reconstruct"),
        record(work / "stages.json"),
        database(work / "database.db"),
        frames(work / "frames"),
        models(work / "models"),
        ordered(work / "sparse") {}

  fs::path root, images, sparse;
  fs::path work, record, database;
  fs::path frames;   // of a video, until all are written
  fs::path models;   // as the mapper writes them
  fs::path ordered;  // by size, until they are accepted
};

using WarnFn = std::function<void(const std::string& line)>;

class Reconstruction {
 public:
  Reconstruction(const ReconstructOptions& options, const ReconstructProgress& progress, const std::atomic<int>* stop,
                 const WarnFn& warn)
      : options_(options),
        progress_(progress),
        warn_(warn),
        source_(fs::absolute(options.input).lexically_normal()),
        folders_(fs::absolute(options.output).lexically_normal()) {
    check_input();
    lock_.emplace(folders_.work, "scene folder");
    log_.emplace(folders_.root / "reconstruct.log", stop);
    colmap_.emplace(options_, ColmapFolders{folders_.database, folders_.images, folders_.models}, *log_);
    record_.emplace(folders_.record);
  }

  ReconstructResult run() {
    const std::vector<std::string> names = is_video_ ? use_video() : use_photographs();
    const CheckedPhotographs photographs = check(names);
    extract_features(photographs);
    match(photographs.names.size());
    map(photographs.names.size());
    accept(photographs.names.size());
    return std::move(result_);
  }

 private:
  void show(const std::string& stage, std::size_t done, std::size_t total) const {
    log_->check_stop();
    if (progress_) progress_(stage, done, total);
  }

  void warn(const std::string& line) const {
    if (warn_) warn_(line);
  }

  /// Before anything is written.
  void check_input() {
    if (!is_there(source_)) input_error("photographs not found: ", options_.input, " (expected a folder or a video)");
    is_video_ = !fs::is_directory(source_);
    if (is_video_ && has_image_extension(source_)) {
      input_error(options_.input, ": only one photograph (expected a folder of photographs, or a video)");
    }
    if (!is_video_ && options_.frames > 0) {
      input_error("--frames has no effect on photographs (", options_.input,
                  " is a folder); it is an option of videos");
    }
    if (is_there(folders_.root) && !fs::is_directory(folders_.root)) {
      input_error("not a folder: ", options_.output, " (expected the scene folder to make)");
    }
    if (source_ == folders_.root && is_there(folders_.images)) source_ = folders_.images;
    if (!is_video_) listed_ = list_photographs(source_, {folders_.work, folders_.images});
    check_colmap_is_installed();
    if (is_video_) check_ffmpeg_is_installed();
    if (is_there(folders_.record)) return;
    // What was there before the first call is the user's.
    for (const fs::path& folder : {folders_.sparse / "0", folders_.sparse, folders_.root}) {
      if (!colmap_format(folder)) continue;
      input_error(folder.string(), ": there is a COLMAP model already, which `b3dgs train ", options_.output,
                  "` takes; choose another scene folder to reconstruct it again");
    }
    if (!is_in_place() && holds_files(folders_.images)) {
      input_error(folders_.images.string(), ": there are files already; to use them, give this folder as PHOTOS, ",
                  "otherwise choose another scene folder");
    }
  }

  bool is_in_place() const {
    std::error_code error;
    return !is_video_ && fs::equivalent(source_, folders_.images, error);
  }

  std::vector<std::string> use_photographs() {
    Json files = Json::array();
    std::vector<std::string> names;
    for (const Photograph& photograph : listed_) {
      files.push_back({photograph.name, photograph.bytes, photograph.changed});
      names.push_back(photograph.name);
    }
    const bool are_there = std::all_of(names.begin(), names.end(),
                                       [&](const std::string& name) { return is_there(folders_.images / name); });
    const bool had_record = is_there(folders_.record);
    if (record_->is_done("photographs", {{"folder", source_.string()}, {"files", files}}, are_there)) return names;
    if (!is_in_place()) {
      place_photographs(source_, folders_.images, listed_, had_record,
                        [&](std::size_t done) { show("copying photographs", done, listed_.size()); });
    }
    record_->finish();
    return names;
  }

  std::vector<std::string> use_video() {
    const Json settings{{"video", source_.string()},
                        {"bytes", fs::file_size(source_)},
                        {"changed", fs::last_write_time(source_).time_since_epoch().count()},
                        {"frames", options_.frames}};
    if (!record_->is_done("frames", settings, is_there(folders_.images / "frame_00001.jpg"))) {
      remove_own(folders_.frames);
      const std::vector<std::string> names =
          extract_frames(source_, static_cast<std::size_t>(options_.frames), folders_.frames, *log_,
                         [&](const char* stage, std::size_t done, std::size_t total) { show(stage, done, total); });
      if (holds_files(folders_.images)) move_folder(folders_.images, free_name(folders_.root / "images.previous"));
      std::error_code error;
      fs::remove(folders_.images, error);  // only if it is empty
      move_folder(folders_.frames, folders_.images);
      record_->set_notes({{"names", names}});
      record_->finish();
    }
    try {
      return record_->notes().at("names").get<std::vector<std::string>>();
    } catch (const nlohmann::json::exception&) {
      input_error(folders_.record.string(), ": damaged; remove it to begin again");
    }
  }

  CheckedPhotographs check(const std::vector<std::string>& names) {
    CheckedPhotographs photographs = check_photographs(
        folders_.images, names, [&](std::size_t done) { show("checking photographs", done, names.size()); });
    constexpr std::size_t kMostNamed = 5;
    const std::vector<std::string>& damaged = photographs.damaged;
    for (std::size_t i = 0; i < std::min(damaged.size(), kMostNamed); ++i) {
      warn("left out: " + damaged[i]);
    }
    if (damaged.size() > kMostNamed) {
      warn(detail::concat("left out: ", damaged.size() - kMostNamed, " more damaged photographs"));
    }
    if (photographs.names.size() < 2) {
      input_error(options_.input, ": ", photographs.names.size(), " of ", names.size(),
                  " photographs can be read (expected at least 2); the first: ", damaged.front());
    }
    return photographs;
  }

  void extract_features(const CheckedPhotographs& photographs) {
    const std::vector<CameraGroup> groups = group_by_camera(photographs, options_.camera_per);
    std::size_t n_before = 0;
    for (std::size_t i = 0; i < groups.size(); ++i) {
      const CameraGroup& group = groups[i];
      const Json settings{{"colmap", colmap_->version()},
                          {"camera_model", options_.camera_model},
                          {"camera_per", options_.camera_per},
                          {"max_features", options_.max_features},
                          {"cameras", group.label},
                          {"photographs", group.names}};
      if (!record_->is_done("features " + std::to_string(i), settings, is_there(folders_.database))) {
        extract_group(group, i == 0, n_before, photographs.names.size());
      }
      n_before += group.names.size();
    }
  }

  void extract_group(const CameraGroup& group, bool is_first, std::size_t n_before, std::size_t n_total) {
    std::optional<std::size_t> camera;
    if (record_->was_begun() && is_there(folders_.database)) {
      // COLMAP keeps the features that it has; the other photographs must get the same camera.
      if (record_->notes().contains("camera") && record_->notes()["camera"].is_number_unsigned()) {
        camera = record_->notes()["camera"].get<std::size_t>();
      }
    } else if (is_first) {
      for (const char* end : {"", "-wal", "-shm", "-journal"}) remove_own(folders_.database.string() + end);
    }
    std::string list;
    for (const std::string& name : group.names) list += name + "\n";
    const fs::path list_file = folders_.work / "photographs.txt";
    write_file(list_file, list);
    show("extracting features", n_before, n_total);
    log_->run(colmap_->extract_command(list_file, group.is_single_camera, camera), [&](const std::string& line) {
      if (const auto step = colmap_step(line)) show("extracting features", n_before + step->done, n_total);
      const auto found = colmap_camera(line);
      if (!found || !group.is_single_camera || camera) return;
      camera = found;
      record_->set_notes({{"camera", *camera}});
    });
    record_->finish();
  }

  void match(std::size_t n_photographs) {
    std::string matcher = options_.matcher;
    if (matcher == "auto") matcher = is_video_ || n_photographs > kMostExhaustive ? "sequential" : "exhaustive";
    if (options_.matcher == "auto" && !is_video_ && n_photographs > kMostExhaustive) {
      warn(detail::concat(
          n_photographs,
          " photographs: only those with neighbouring names are matched; if they were not taken in this ",
          "order, add --matcher exhaustive, which takes longer"));
    }
    if (record_->is_done("matches", {{"matcher", matcher}}, is_there(folders_.database))) return;
    show("matching", 0, 0);
    log_->run(colmap_->match_command(matcher, n_photographs), [&](const std::string& line) {
      if (const auto step = colmap_step(line)) show("matching", step->done, step->total);
    });
    record_->finish();
  }

  void map(std::size_t n_photographs) {
    const bool are_there = colmap_format(folders_.ordered / "0") || colmap_format(folders_.sparse / "0");
    if (record_->is_done("models", Json::object(), are_there)) return;
    remove_own(folders_.models);
    remove_own(folders_.ordered);
    create_folder(folders_.models);
    show("registering photographs", 0, n_photographs);
    std::string failure;
    try {
      log_->run(colmap_->map_command(), [&](const std::string& line) {
        if (const auto step = colmap_step(line))
          show("registering photographs", std::min(step->done, n_photographs), n_photographs);
      });
    } catch (const InputError& error) {
      failure = error.what();
    }
    // Without a model, some versions of the mapper fail, and others only say so.
    if (failure.find("killed") != std::string::npos) input_error(failure);
    if (order_models(folders_.models, folders_.ordered) == 0) {
      const bool is_no_pair =
          failure.empty() || failure.find("model") != std::string::npos || failure.find("initial") != std::string::npos;
      if (!is_no_pair) input_error(failure);
      input_error(options_.input, ": too few matches: COLMAP found no two photographs to begin with; ",
                  kHowToPhotograph, " (log: ", (folders_.root / "reconstruct.log").string(), ")");
    }
    if (!failure.empty()) input_error(failure);
    record_->finish();
  }

  /// Moves the models to SCENE/sparse if enough photographs are registered.
  void accept(std::size_t n_photographs) {
    const bool is_new = is_there(folders_.ordered);
    const fs::path models = is_new ? folders_.ordered : folders_.sparse;
    result_.n_photographs = n_photographs;
    while (colmap_format(models / std::to_string(result_.n_models))) ++result_.n_models;
    const ColmapModel model = read_colmap_model(models / "0");
    result_.n_registered = model.images.size();
    result_.n_points = model.points.size();
    for (const ColmapPoint& point : model.points) {
      result_.mean_error += point.error / static_cast<double>(model.points.size());
    }
    const double share = static_cast<double>(result_.n_registered) / static_cast<double>(n_photographs);
    const std::string registered =
        detail::concat("only ", result_.n_registered, " of ", n_photographs, " photographs (",
                       static_cast<int>(std::floor(100 * share)), " %) are registered",
                       result_.n_models > 1 ? detail::concat(" in the largest of ", result_.n_models, " models") : "");
    if (share < options_.min_registered) {
      input_error(options_.input, ": ", registered, "; photograph the places between the parts again, with two thirds ",
                  "of overlap, or add --min_registered ", std::floor(100 * share) / 100,
                  " to use this model (it is kept in ", models.string(), ")");
    }
    if (share < kWarnBelow) {
      warn(registered + "; views that are missing leave holes: " + kHowToPhotograph);
    }
    if (!is_new) return;
    if (is_there(folders_.sparse)) move_folder(folders_.sparse, free_name(folders_.root / "sparse.previous"));
    move_folder(folders_.ordered, folders_.sparse);
    remove_own(folders_.models);
  }

  const ReconstructOptions& options_;
  const ReconstructProgress& progress_;
  const WarnFn& warn_;
  fs::path source_;
  SceneFolders folders_;
  bool is_video_ = false;
  std::vector<Photograph> listed_;  // unless it is a video
  std::optional<FolderLock> lock_;
  std::optional<ProgramLog> log_;
  std::optional<ColmapProgram> colmap_;
  std::optional<StageRecord> record_;
  ReconstructResult result_;
};

}  // namespace

ReconstructResult reconstruct(const ReconstructOptions& options, const ReconstructProgress& progress,
                              const std::atomic<int>* stop, const WarnFn& warn) {
  try {
    return Reconstruction(options, progress, stop, warn).run();
  } catch (const Stopped&) {
    ReconstructResult result;
    result.is_stopped = true;
    return result;
  }
}

}  // namespace b3dgs
