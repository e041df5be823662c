#include "app/reconstruct/reconstruct.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include "app/georeference/georeference_scene.h"
#include "app/reconstruct/colmap_program.h"
#include "app/reconstruct/panoramas.h"
#include "app/reconstruct/photographs.h"
#include "app/reconstruct/program_log.h"
#include "app/reconstruct/reconstruct_input.h"
#include "app/reconstruct/scene_folder.h"
#include "app/reconstruct/stage_record.h"
#include "app/reconstruct/video_frames.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kWarnBelow = 0.8;            // share of registered photographs
constexpr std::size_t kMostExhaustive = 300;  // photographs; pairs grow with the square
// Photographs. The time of COLMAP's incremental mapper grows faster than their number.
constexpr std::size_t kMostIncremental = 200;
constexpr const char* kHowToPhotograph =
    "photograph again with two thirds of overlap between neighbours, sharp, from many places, with the same zoom";

class Reconstruction {
 public:
  Reconstruction(const ReconstructOptions& options, const ReconstructProgress& progress, const std::atomic<int>* stop,
                 const WarnFn& warn)
      : options_(options),
        progress_(progress),
        warn_(warn),
        places_(real_path(options.output)),
        input_(check_input(options, places_, warn)),
        folder_(places_, warn),
        log_(places_.log, stop),
        colmap_(options, {places_.database, is_panoramas_ ? places_.faces : places_.images, places_.models}, log_),
        record_(places_.record) {}

  ReconstructResult run() {
    const std::vector<std::string> names = input_.is_video ? use_video() : use_photographs();
    const CheckedPhotographs photographs = check(names);
    const CheckedPhotographs images = is_panoramas_ ? cut_faces(photographs) : photographs;
    extract_features(images);
    match(photographs.names.size(), images.names.size());
    map(photographs, images.names.size());
    accept(photographs.names.size());
    return result_;
  }

 private:
  void show(const std::string& stage, std::size_t done, std::size_t total) const {
    log_.check_stop();
    progress_(stage, done, total);
  }

  /// Returns the name of the input for stages.json. An earlier call's name is kept if it is the same path, whatever its
  /// name now.
  std::string source_name(const char* stage, const char* key) const {
    const std::string earlier = record_.earlier_text(stage, key);
    return !earlier.empty() && is_same_place(earlier, input_.source) ? earlier : input_.source.string();
  }

  /// Marks files written at the paths as the program's own when it is destroyed, also by an exception.
  struct Recorder {
    ~Recorder() {
      for (const fs::path& path : paths) folder.add(path);
    }
    SceneFolder& folder;
    std::vector<fs::path> paths;
  };

  /// Runs a program that writes at the paths. Files that existed before and were not the program's own still belong to
  /// the user, such as a database that was changed by hand.
  void run(const std::vector<std::string>& command, const OnChildLine& on_line, std::vector<fs::path> written) {
    const auto is_users = [&](const fs::path& path) { return folder_.has_others(path); };
    written.erase(std::remove_if(written.begin(), written.end(), is_users), written.end());
    const Recorder at_end{folder_, written};
    log_.run(command, on_line);
  }

  std::vector<std::string> use_photographs() {
    Json files = Json::array();
    std::vector<std::string> names;
    for (const Photograph& photograph : input_.photographs) {
      files.push_back({photograph.name, photograph.bytes, photograph.changed});
      names.push_back(photograph.name);
    }
    const bool are_there = std::all_of(names.begin(), names.end(),
                                       [&](const std::string& name) { return is_there(places_.images / name); });
    const std::string source = source_name("photographs", "folder");
    if (record_.is_done("photographs", {{"folder", source}, {"files", files}}, are_there)) return names;
    if (input_.is_in_place) {
      warn_turned(
          count_turned(input_.source, input_.photographs),
          "lie on their side or upside down (EXIF orientation), and so will the views of the model; photographs "
          "that are copied from another folder are turned");
    } else {
      place();
    }
    record_.finish();
    return names;
  }

  void warn_turned(std::size_t n_turned, const char* what) const {
    if (n_turned > 0) warn_(detail::concat(n_turned, " of ", input_.photographs.size(), " photographs ", what));
  }

  void place() {
    const std::string other = find_in_the_way(input_.source, places_.images, input_.photographs);
    if (!other.empty()) {
      folder_.move_aside(places_.images, detail::concat(other, " in ", places_.images.string(),
                                                        " is another file than in ", options_.input));
    }
    warn_turned(
        place_photographs(input_.source, places_.images, input_.photographs,
                          [&](std::size_t done) { show("copying photographs", done, input_.photographs.size()); }),
        "were turned upright, as their EXIF orientation says: these copies are encoded again, with JPEG quality 98");
  }

  std::vector<std::string> use_video() {
    const Json settings{{"video", source_name("frames", "video")},
                        {"bytes", fs::file_size(input_.source)},
                        {"changed", fs::last_write_time(input_.source).time_since_epoch().count()},
                        {"frames", options_.frames}};
    if (!record_.is_done("frames", settings, is_there(places_.images / "frame_00001.jpg"))) {
      const std::vector<std::string> names = write_frames();
      std::error_code error;
      if (!holds_files(places_.images)) fs::remove(places_.images, error);
      folder_.move_aside(places_.images);
      folder_.own().move(places_.frames, places_.images);
      record_.set_notes({{"names", names}});
      record_.finish();
    }
    try {
      return record_.notes().at("names").get<std::vector<std::string>>();
    } catch (const nlohmann::json::exception&) {
      input_error(places_.record.string(), ": damaged; remove it to begin again");
    }
  }

  std::vector<std::string> write_frames() {
    folder_.clear(places_.frames);
    const Recorder at_end{folder_, {places_.frames}};
    return extract_frames(input_.source, static_cast<std::size_t>(options_.frames), places_.frames, log_,
                          [&](const char* stage, std::size_t done, std::size_t total) { show(stage, done, total); });
  }

  CheckedPhotographs check(const std::vector<std::string>& names) {
    CheckedPhotographs photographs = check_photographs(
        places_.images, names, [&](std::size_t done) { show("checking photographs", done, names.size()); });
    constexpr std::size_t kMostNamed = 5;
    const std::vector<std::string>& damaged = photographs.damaged;
    for (std::size_t i = 0; i < std::min(damaged.size(), kMostNamed); ++i) {
      warn_("left out: " + damaged[i]);
    }
    if (damaged.size() > kMostNamed) {
      warn_(detail::concat("left out: ", damaged.size() - kMostNamed, " more damaged photographs"));
    }
    if (photographs.names.size() < 2) {
      input_error(options_.input, ": ", photographs.names.size(), " of ", names.size(),
                  input_.is_video ? " frames" : " photographs", " can be read (expected at least 2)",
                  damaged.empty() ? "" : "; the first that cannot: " + damaged.front());
    }
    check_sizes(photographs);
    return photographs;
  }

  void check_sizes(const CheckedPhotographs& photographs) const {
    const std::vector<ImageSize>& sizes = photographs.sizes;
    const auto other = std::find_if_not(sizes.begin(), sizes.end(), has_panorama_size);
    if (is_panoramas_ && other != sizes.end()) {
      input_error((places_.images / photographs.names[static_cast<std::size_t>(other - sizes.begin())]).string(),
                  ": expected a panorama of 360 x 180 degrees, twice as wide as high (--camera_model ",
                  options_.camera_model, "), found ", other->width, " x ", other->height, " px; ",
                  input_.is_video ? "" : "leave it out of " + options_.input + ", or ",
                  "give the camera model of these photographs");
    }
    if (other == sizes.end() && options_.camera_model == ReconstructOptions{}.camera_model) {
      warn_(
          "all photographs are twice as wide as high; if they are panoramas of 360 degrees, stop and add "
          "--camera_model EQUIRECTANGULAR");
    }
  }

  /// Returns the images that COLMAP gets instead of panoramas.
  CheckedPhotographs cut_faces(const CheckedPhotographs& panoramas) {
    const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
    const ImageSize size{cameras[0].width, cameras[0].height};
    colmap_.use_faces(pinhole_params(cameras[0]), cameras.size());
    const Json settings{{"panoramas", panoramas.names}, {"faces", cameras.size()}, {"side", size.width}};
    if (!record_.is_done("faces", settings, true) && !record_.was_begun()) folder_.clear(places_.faces);
    CheckedPhotographs faces;
    faces.names = cut_panoramas(places_.images, places_.faces, panoramas,
                                [&](std::size_t done) { show("cutting panoramas", done, panoramas.names.size()); });
    faces.sizes.assign(faces.names.size(), size);
    record_.finish();
    return faces;
  }

  void extract_features(const CheckedPhotographs& photographs) {
    const std::vector<CameraGroup> groups = group_by_camera(photographs, is_panoramas_ ? "size" : options_.camera_per);
    Json settings{{"colmap", colmap_.version()},
                  {"camera_model", options_.camera_model},
                  {"camera_per", options_.camera_per},
                  {"max_features", options_.max_features},
                  {"groups", Json::array()}};
    for (const CameraGroup& group : groups) settings["groups"].push_back(group.names);
    if (record_.is_done("features", settings, is_there(places_.database))) return;
    // Continues an earlier call. COLMAP keeps its existing features, and the other photographs of the group get the
    // same camera. If COLMAP was ended before it had printed this camera, extraction starts again.
    std::size_t first = groups.size();
    std::optional<std::size_t> camera;
    if (record_.was_begun() && is_there(places_.database)) {
      first = noted("groups").value_or(groups.size());  // none: an earlier database had not been removed
      camera = noted("camera");
    }
    if (first >= groups.size() || (groups[first].is_single_camera && !camera)) {
      folder_.clear_database();
      first = 0;
      camera.reset();
    }
    std::size_t n_before = 0;
    for (std::size_t i = 0; i < groups.size(); ++i) {
      const auto on_step = [&](std::size_t done) {
        show("extracting features", n_before + done, photographs.names.size());
      };
      if (i >= first) extract_group(groups[i], i, i == first ? camera : std::nullopt, on_step);
      n_before += groups[i].names.size();
    }
    record_.finish();
  }

  std::optional<std::size_t> noted(const char* key) const {
    const Json& notes = record_.notes();
    if (!notes.contains(key) || !notes[key].is_number_unsigned()) return std::nullopt;
    return notes[key].get<std::size_t>();
  }

  void extract_group(const CameraGroup& group, std::size_t index, std::optional<std::size_t> camera,
                     const std::function<void(std::size_t done)>& on_step) {
    const auto note = [&] {
      Json notes{{"groups", index}};
      if (camera) notes["camera"] = *camera;
      record_.set_notes(notes);
    };
    note();
    std::string list;
    for (const std::string& name : group.names) list += name + "\n";
    const fs::path list_file = places_.work / "photographs.txt";
    write_file(list_file, list);
    on_step(0);
    const std::vector<std::string> command = colmap_.extract_command(list_file, group.is_single_camera, camera);
    const auto on_line = [&](const std::string& line) {
      if (const auto step = colmap_step(line)) on_step(step->done);
      if (!group.is_single_camera || camera) return;
      camera = colmap_camera(line);
      if (camera) note();
    };
    run(command, on_line, database_files(places_.database));
  }

  void match(std::size_t n_photographs, std::size_t n_images) {
    std::string matcher = options_.matcher;
    if (matcher == "auto") matcher = input_.is_video || n_images > kMostExhaustive ? "sequential" : "exhaustive";
    if (options_.matcher == "auto" && !input_.is_video && n_images > kMostExhaustive) {
      warn_(detail::concat(
          n_photographs,
          " photographs: only those with neighbouring names are matched; if they were not taken in this ",
          "order, add --matcher exhaustive, which takes longer"));
    }
    if (record_.is_done("matches", {{"matcher", matcher}}, is_there(places_.database))) return;
    // COLMAP prints a line for each block of pairs, or for each photograph that is matched with its neighbours.
    const bool is_exhaustive = matcher == "exhaustive";
    const char* const stage = is_exhaustive ? "matching, pairs" : "matching, photographs";
    const std::size_t block = is_exhaustive ? colmap_.pairs_block(n_images) : 0;
    const std::size_t n_pairs = is_exhaustive ? n_images * (n_images - 1) / 2 : 0;
    show(stage, 0, n_pairs);
    const auto on_line = [&](const std::string& line) {
      const auto step = colmap_step(line);
      if (step && is_exhaustive) show(stage, pairs_in_blocks(n_images, block, step->done), n_pairs);
      if (step && !is_exhaustive) show(stage, step->done, step->total);
    };
    run(colmap_.match_command(matcher, n_images), on_line, database_files(places_.database));
    record_.finish();
  }

  void map(const CheckedPhotographs& photographs, std::size_t n_images) {
    const bool are_there = colmap_format(places_.ordered / "0") || colmap_format(places_.sparse / "0");
    if (record_.is_done("models", Json::object(), are_there)) return;
    std::optional<ProgramFailed> failure;
    std::size_t n_models = 0;
    const bool is_large = n_images > kMostIncremental && !is_panoramas_;
    if (is_large && colmap_.has_command("global_mapper")) {
      n_models = run_mapper("global_mapper", photographs, n_images, failure);
      const std::string why = failure ? failure->what() : "colmap global_mapper made no model";
      if (failure || n_models == 0) warn_(why + "; the slower mapper is used instead");
    }
    if (failure || n_models == 0) n_models = run_mapper("mapper", photographs, n_images, failure);
    if (n_models == 0) {  // some versions of the mapper fail then, and others only print it
      const auto says = [&](const char* word) { return failure->reason.find(word) != std::string::npos; };
      if (failure && !says("model") && !says("initial")) throw ProgramFailed(*failure);
      input_error(options_.input, ": too few matches: COLMAP found no two photographs to begin with; ",
                  kHowToPhotograph, " (log: ", places_.log.string(), ")");
    }
    if (failure) throw ProgramFailed(*failure);
    record_.finish();
  }

  /// Runs a mapper, and returns the number of models.
  std::size_t run_mapper(const std::string& mapper, const CheckedPhotographs& photographs, std::size_t n_images,
                         std::optional<ProgramFailed>& failure) {
    failure.reset();
    folder_.clear(places_.models);
    folder_.clear(places_.ordered);
    create_folder(places_.models);
    show("registering photographs", 0, n_images);
    try {
      const auto on_line = [&](const std::string& line) {
        if (const auto step = colmap_step(line))
          show("registering photographs", std::min(step->done, n_images), n_images);
      };
      std::vector<fs::path> written = database_files(places_.database);
      written.push_back(places_.models);
      run(colmap_.map_command(mapper), on_line, written);
    } catch (const ProgramFailed& error) {
      failure = error;
    }
    const std::size_t n_models = is_panoramas_ ? join_models(places_.models, places_.ordered, photographs)
                                               : order_models(places_.models, places_.ordered);
    folder_.add(places_.ordered);
    return n_models;
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
      warn_(registered + "; views that are missing leave holes: " + kHowToPhotograph);
    }
    if (is_new) folder_.clear(places_.root / Georeference::kFile);
    if (!is_there(places_.root / Georeference::kFile)) georeference(models / "0");
    result_.georeference = read_georeference(places_.root);
    if (!is_new) return;
    folder_.move_aside(places_.sparse);
    folder_.own().move(places_.ordered, places_.sparse);
    folder_.own().remove(places_.models);
  }

  /// Puts the model in metres, if GPS positions of the photographs agree with it.
  void georeference(const fs::path& model) {
    if (!options_.georeference || input_.is_video) return;
    show("reading GPS positions", 0, 0);
    // From the originals, because copies that were turned upright have no EXIF data.
    const auto photograph = [&](const std::string& name) { return input_.source / name; };
    const std::string why_not = georeference_scene(places_.root, model, photograph).why_not;
    if (!why_not.empty()) warn_(why_not + "; the model keeps COLMAP's unit of length and axes");
  }

  const ReconstructOptions& options_;
  const ReconstructProgress& progress_;
  const WarnFn& warn_;
  const bool is_panoramas_ = options_.camera_model == camera_model_name(CameraModel::kEquirectangular);
  ScenePlaces places_;
  ReconstructInput input_;
  SceneFolder folder_;
  ProgramLog log_;
  ColmapProgram colmap_;
  StageRecord record_;
  ReconstructResult result_;
};

}  // namespace

ReconstructResult reconstruct(const ReconstructOptions& options, const ReconstructProgress& progress,
                              const std::atomic<int>* stop, const WarnFn& warn) {
  const ReconstructProgress progress_or_none = progress ? progress : [](const auto&...) {};
  const WarnFn warn_or_none = warn ? warn : [](const std::string&) {};
  try {
    return Reconstruction(options, progress_or_none, stop, warn_or_none).run();
  } catch (const Stopped&) {
    ReconstructResult result;
    result.is_stopped = true;
    return result;
  }
}

}  // namespace b3dgs
