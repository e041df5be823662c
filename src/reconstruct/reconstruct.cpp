#include "reconstruct/reconstruct.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"
#include "core/text.h"
#include "reconstruct/colmap_program.h"
#include "reconstruct/photographs.h"
#include "reconstruct/program_log.h"
#include "reconstruct/scene_folder.h"
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

bool is_same_place(const fs::path& a, const fs::path& b) {
  std::error_code error;
  return a == b || fs::equivalent(a, b, error);
}

/// Whether `path` lies below `folder`. Both without links.
bool is_inside(const fs::path& path, const fs::path& folder) {
  const fs::path relative = path.lexically_relative(folder);
  return !relative.empty() && *relative.begin() != ".." && relative != ".";
}

class Reconstruction {
 public:
  Reconstruction(const ReconstructOptions& options, const ReconstructProgress& progress, const std::atomic<int>* stop,
                 const WarnFn& warn)
      : options_(options),
        progress_(progress),
        warn_(warn),
        source_(real_path(options.input)),
        places_(real_path(options.output)) {
    check_input();
    folder_.emplace(places_, warn_);
    make_way(places_.log);
    log_.emplace(places_.log, stop);
    OwnFiles::of(places_.log)->add(places_.log, /*is_growing=*/true);
    colmap_.emplace(options_, ColmapFolders{places_.database, places_.images, places_.models}, *log_);
    record_.emplace(places_.record);
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
    if (is_there(places_.root) && !fs::is_directory(places_.root)) {
      input_error("not a folder: ", options_.output, " (expected the scene folder to make)");
    }
    if (options_.frames == 1) input_error("--frames 1: expected at least 2 frames, each from another place");
    check_work_folder(places_);
    if (!is_video_) list_input();
    check_colmap_is_installed();
    if (is_video_) check_ffmpeg_is_installed();
    if (is_stage_record(places_.record)) return;
    // What was there before the first call is the user's.
    for (const fs::path& folder : {places_.sparse / "0", places_.sparse, places_.root}) {
      if (!colmap_format(folder)) continue;
      input_error(folder.string(), ": there is a COLMAP model already, which `b3dgs train ",
                  shell_quote(options_.output), "` takes; choose another scene folder to reconstruct it again");
    }
    if (!is_in_place() && holds_files(places_.images)) {
      input_error(places_.images.string(), ": there are files already; to use them, give this folder as PHOTOS, ",
                  "otherwise choose another scene folder");
    }
  }

  void list_input() {
    if (is_same_place(source_, places_.root)) {
      // Photographs beside SCENE/images would be found twice the next time.
      if (!is_there(places_.images)) {
        input_error(options_.output, ": is the folder of the photographs, too (expected another folder); ",
                    "choose another scene folder, or move the photographs to ", places_.images.string());
      }
      source_ = places_.images;
    }
    std::vector<fs::path> except{places_.work};
    if (is_inside(places_.root, source_)) except = {places_.root};
    if (is_inside(places_.images, source_)) except.push_back(places_.images);
    PhotographList list = list_photographs(source_, except);
    listed_ = std::move(list.photographs);
    if (list.unreadable.empty()) return;
    warn(detail::one_line(detail::concat(list.unreadable.size(), " raw or HEIC files are left out (the first: ",
                                         list.unreadable[0], "); convert them to JPEG to use them")));
  }

  bool is_in_place() const { return !is_video_ && is_same_place(source_, places_.images); }

  /// The name of the input in the record: that of an earlier call if it is the same place, whatever it is called now.
  std::string source_name(const char* stage, const char* key) const {
    const std::string earlier = record_->earlier_text(stage, key);
    return !earlier.empty() && is_same_place(earlier, source_) ? earlier : source_.string();
  }

  /// Runs a program, and records what it has written at the paths. Files that were there before and were not the
  /// program's own stay the user's, such as a database that was changed by hand.
  void run(const std::vector<std::string>& command, const OnChildLine& on_line, std::vector<fs::path> written) {
    written.erase(
        std::remove_if(written.begin(), written.end(), [&](const fs::path& path) { return folder_->has_others(path); }),
        written.end());
    const auto record = [&] {
      for (const fs::path& path : written) folder_->add(path);
    };
    try {
      log_->run(command, on_line);
    } catch (...) {
      record();
      throw;
    }
    record();
  }

  std::vector<fs::path> database_files() const {
    const std::string base = places_.database.string();
    return {base, base + "-wal", base + "-shm", base + "-journal"};
  }

  std::vector<std::string> use_photographs() {
    Json files = Json::array();
    std::vector<std::string> names;
    for (const Photograph& photograph : listed_) {
      files.push_back({photograph.name, photograph.bytes, photograph.changed});
      names.push_back(photograph.name);
    }
    const bool are_there = std::all_of(names.begin(), names.end(),
                                       [&](const std::string& name) { return is_there(places_.images / name); });
    const std::string source = source_name("photographs", "folder");
    if (record_->is_done("photographs", {{"folder", source}, {"files", files}}, are_there)) return names;
    if (is_in_place()) {
      if (const std::size_t n_turned = count_turned(source_, listed_); n_turned > 0) {
        warn(detail::concat(n_turned, " of ", names.size(), " photographs lie on their side or upside down (EXIF ",
                            "orientation), and so will the views of the model; photographs that are copied from ",
                            "another folder are turned"));
      }
    } else {
      place();
    }
    record_->finish();
    return names;
  }

  void place() {
    const std::string other = find_in_the_way(source_, places_.images, listed_);
    if (!other.empty()) {
      folder_->move_aside(places_.images, detail::concat(other, " in ", places_.images.string(),
                                                         " is another file than in ", options_.input));
    }
    const std::size_t n_turned = place_photographs(
        source_, places_.images, listed_, [&](std::size_t done) { show("copying photographs", done, listed_.size()); });
    if (n_turned == 0) return;
    warn(detail::concat(n_turned, " of ", listed_.size(), " photographs were turned upright, as their EXIF ",
                        "orientation says: these copies are encoded again, with JPEG quality 98"));
  }

  std::vector<std::string> use_video() {
    const Json settings{{"video", source_name("frames", "video")},
                        {"bytes", fs::file_size(source_)},
                        {"changed", fs::last_write_time(source_).time_since_epoch().count()},
                        {"frames", options_.frames}};
    if (!record_->is_done("frames", settings, is_there(places_.images / "frame_00001.jpg"))) {
      const std::vector<std::string> names = write_frames();
      std::error_code error;
      if (!holds_files(places_.images)) fs::remove(places_.images, error);
      folder_->move_aside(places_.images);
      folder_->own().move(places_.frames, places_.images);
      record_->set_notes({{"names", names}});
      record_->finish();
    }
    try {
      return record_->notes().at("names").get<std::vector<std::string>>();
    } catch (const nlohmann::json::exception&) {
      input_error(places_.record.string(), ": damaged; remove it to begin again");
    }
  }

  std::vector<std::string> write_frames() {
    folder_->clear(places_.frames);
    try {
      std::vector<std::string> names =
          extract_frames(source_, static_cast<std::size_t>(options_.frames), places_.frames, *log_,
                         [&](const char* stage, std::size_t done, std::size_t total) { show(stage, done, total); });
      folder_->add(places_.frames);
      return names;
    } catch (...) {
      folder_->add(places_.frames);
      throw;
    }
  }

  CheckedPhotographs check(const std::vector<std::string>& names) {
    CheckedPhotographs photographs = check_photographs(
        places_.images, names, [&](std::size_t done) { show("checking photographs", done, names.size()); });
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
                  is_video_ ? " frames" : " photographs", " can be read (expected at least 2)",
                  damaged.empty() ? "" : "; the first that cannot: " + damaged.front());
    }
    return photographs;
  }

  void extract_features(const CheckedPhotographs& photographs) {
    const std::vector<CameraGroup> groups = group_by_camera(photographs, options_.camera_per);
    if (extract_groups(groups, photographs.names.size())) return;
    // COLMAP was ended before it had said which camera the first photographs of a group got. The others would get a
    // second one, so all begin again.
    record_->go_back_to(group_stage(0));
    const bool is_done = extract_groups(groups, photographs.names.size());
    B3DGS_CHECK(is_done, "a new database");
  }

  static std::string group_stage(std::size_t group) { return "features " + std::to_string(group); }

  /// False if the database has a camera that the record does not know.
  bool extract_groups(const std::vector<CameraGroup>& groups, std::size_t n_total) {
    std::size_t n_before = 0;
    for (std::size_t i = 0; i < groups.size(); ++i) {
      const CameraGroup& group = groups[i];
      const Json settings{{"colmap", colmap_->version()},
                          {"camera_model", options_.camera_model},
                          {"camera_per", options_.camera_per},
                          {"max_features", options_.max_features},
                          {"cameras", group.label},
                          {"photographs", group.names}};
      if (!record_->is_done(group_stage(i), settings, is_there(places_.database))) {
        const bool goes_on = record_->was_begun() && is_there(places_.database);
        const bool has_camera = record_->notes().contains("camera") && record_->notes()["camera"].is_number_unsigned();
        if (goes_on && group.is_single_camera && !has_camera) return false;
        if (!goes_on && i == 0) folder_->clear_database();
        std::optional<std::size_t> camera;  // COLMAP keeps the features that it has; the others get the same camera
        if (goes_on && has_camera) camera = record_->notes()["camera"].get<std::size_t>();
        extract_group(group, camera, n_before, n_total);
      }
      n_before += group.names.size();
    }
    return true;
  }

  void extract_group(const CameraGroup& group, std::optional<std::size_t> camera, std::size_t n_before,
                     std::size_t n_total) {
    std::string list;
    for (const std::string& name : group.names) list += name + "\n";
    const fs::path list_file = places_.work / "photographs.txt";
    write_file(list_file, list);
    show("extracting features", n_before, n_total);
    const auto on_line = [&](const std::string& line) {
      if (const auto step = colmap_step(line)) show("extracting features", n_before + step->done, n_total);
      const auto found = colmap_camera(line);
      if (!found || !group.is_single_camera || camera) return;
      camera = found;
      record_->set_notes({{"camera", *camera}});
    };
    run(colmap_->extract_command(list_file, group.is_single_camera, camera), on_line, database_files());
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
    if (record_->is_done("matches", {{"matcher", matcher}}, is_there(places_.database))) return;
    show("matching", 0, 0);
    const auto on_line = [&](const std::string& line) {
      if (const auto step = colmap_step(line)) show("matching", step->done, step->total);
    };
    run(colmap_->match_command(matcher, n_photographs), on_line, database_files());
    record_->finish();
  }

  void map(std::size_t n_photographs) {
    const bool are_there = colmap_format(places_.ordered / "0") || colmap_format(places_.sparse / "0");
    if (record_->is_done("models", Json::object(), are_there)) return;
    folder_->clear(places_.models);
    folder_->clear(places_.ordered);
    create_folder(places_.models);
    show("registering photographs", 0, n_photographs);
    std::string failure;
    try {
      const auto on_line = [&](const std::string& line) {
        if (const auto step = colmap_step(line))
          show("registering photographs", std::min(step->done, n_photographs), n_photographs);
      };
      std::vector<fs::path> written = database_files();
      written.push_back(places_.models);
      run(colmap_->map_command(), on_line, written);
    } catch (const InputError& error) {
      failure = error.what();
    }
    // Without a model, some versions of the mapper fail, and others only say so.
    if (failure.find("killed") != std::string::npos) input_error(failure);
    const std::size_t n_models = order_models(places_.models, places_.ordered);
    folder_->add(places_.ordered);
    if (n_models == 0) {
      const bool is_no_pair =
          failure.empty() || failure.find("model") != std::string::npos || failure.find("initial") != std::string::npos;
      if (!is_no_pair) input_error(failure);
      input_error(options_.input, ": too few matches: COLMAP found no two photographs to begin with; ",
                  kHowToPhotograph, " (log: ", (places_.log).string(), ")");
    }
    if (!failure.empty()) input_error(failure);
    record_->finish();
  }

  /// Moves the models to SCENE/sparse if enough photographs are registered.
  void accept(std::size_t n_photographs) {
    const bool is_new = colmap_format(places_.ordered / "0").has_value();
    const fs::path models = is_new ? places_.ordered : places_.sparse;
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
    folder_->move_aside(places_.sparse);
    folder_->own().move(places_.ordered, places_.sparse);
    folder_->own().remove(places_.models);
  }

  const ReconstructOptions& options_;
  const ReconstructProgress& progress_;
  const WarnFn& warn_;
  fs::path source_;
  ScenePlaces places_;
  bool is_video_ = false;
  std::vector<Photograph> listed_;  // unless it is a video
  std::optional<SceneFolder> folder_;
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
