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
#include "reconstruct/panoramas.h"
#include "reconstruct/photographs.h"
#include "reconstruct/program_log.h"
#include "reconstruct/reconstruct_input.h"
#include "reconstruct/scene_folder.h"
#include "reconstruct/stage_record.h"
#include "reconstruct/video_frames.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kWarnBelow = 0.8;            // of the photographs registered
constexpr std::size_t kMostExhaustive = 300;  // photographs; pairs grow with the square
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
        input_(check_input(options, places_, warn)) {
    is_panoramas_ = options.camera_model == camera_model_name(CameraModel::kEquirectangular);
    folder_.emplace(places_, warn_);
    make_way(places_.log);
    log_.emplace(places_.log, stop);
    OwnFiles::of(places_.log)->add(places_.log, /*is_growing=*/true);
    const fs::path& images = is_panoramas_ ? places_.faces : places_.images;
    colmap_.emplace(options_, ColmapFolders{places_.database, images, places_.models}, *log_);
    record_.emplace(places_.record);
  }

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
    log_->check_stop();
    progress_(stage, done, total);
  }

  /// The name of the input in the record: that of an earlier call if it is the same place, whatever it is called now.
  std::string source_name(const char* stage, const char* key) const {
    const std::string earlier = record_->earlier_text(stage, key);
    return !earlier.empty() && is_same_place(earlier, input_.source) ? earlier : input_.source.string();
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
    if (record_->is_done("photographs", {{"folder", source}, {"files", files}}, are_there)) return names;
    if (input_.is_in_place) {
      if (const std::size_t n_turned = count_turned(input_.source, input_.photographs); n_turned > 0) {
        warn_(detail::concat(n_turned, " of ", names.size(), " photographs lie on their side or upside down (EXIF ",
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
    const std::string other = find_in_the_way(input_.source, places_.images, input_.photographs);
    if (!other.empty()) {
      folder_->move_aside(places_.images, detail::concat(other, " in ", places_.images.string(),
                                                         " is another file than in ", options_.input));
    }
    const std::size_t n_turned =
        place_photographs(input_.source, places_.images, input_.photographs,
                          [&](std::size_t done) { show("copying photographs", done, input_.photographs.size()); });
    if (n_turned == 0) return;
    warn_(detail::concat(n_turned, " of ", input_.photographs.size(),
                         " photographs were turned upright, as their EXIF ",
                         "orientation says: these copies are encoded again, with JPEG quality 98"));
  }

  std::vector<std::string> use_video() {
    const Json settings{{"video", source_name("frames", "video")},
                        {"bytes", fs::file_size(input_.source)},
                        {"changed", fs::last_write_time(input_.source).time_since_epoch().count()},
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
          extract_frames(input_.source, static_cast<std::size_t>(options_.frames), places_.frames, *log_,
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

  /// What COLMAP gets instead of panoramas.
  CheckedPhotographs cut_faces(const CheckedPhotographs& panoramas) {
    const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
    const ImageSize size{cameras[0].width, cameras[0].height};
    colmap_->use_faces(pinhole_params(cameras[0]), cameras.size());
    const Json settings{{"panoramas", panoramas.names}, {"faces", cameras.size()}, {"side", size.width}};
    if (!record_->is_done("faces", settings, true) && !record_->was_begun()) folder_->clear(places_.faces);
    CheckedPhotographs faces;
    faces.names = cut_panoramas(places_.images, places_.faces, panoramas,
                                [&](std::size_t done) { show("cutting panoramas", done, panoramas.names.size()); });
    faces.sizes.assign(faces.names.size(), size);
    record_->finish();
    return faces;
  }

  void extract_features(const CheckedPhotographs& photographs) {
    const std::vector<CameraGroup> groups = group_by_camera(photographs, is_panoramas_ ? "size" : options_.camera_per);
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
    run(colmap_->extract_command(list_file, group.is_single_camera, camera), on_line, database_files(places_.database));
    record_->finish();
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
    if (record_->is_done("matches", {{"matcher", matcher}}, is_there(places_.database))) return;
    show("matching", 0, 0);
    const auto on_line = [&](const std::string& line) {
      if (const auto step = colmap_step(line)) show("matching", step->done, step->total);
    };
    run(colmap_->match_command(matcher, n_images), on_line, database_files(places_.database));
    record_->finish();
  }

  void map(const CheckedPhotographs& photographs, std::size_t n_images) {
    const bool are_there = colmap_format(places_.ordered / "0") || colmap_format(places_.sparse / "0");
    if (record_->is_done("models", Json::object(), are_there)) return;
    folder_->clear(places_.models);
    folder_->clear(places_.ordered);
    create_folder(places_.models);
    show("registering photographs", 0, n_images);
    std::string failure;
    try {
      const auto on_line = [&](const std::string& line) {
        if (const auto step = colmap_step(line))
          show("registering photographs", std::min(step->done, n_images), n_images);
      };
      std::vector<fs::path> written = database_files(places_.database);
      written.push_back(places_.models);
      run(colmap_->map_command(), on_line, written);
    } catch (const InputError& error) {
      failure = error.what();
    }
    // Without a model, some versions of the mapper fail, and others only say so.
    if (failure.find("killed") != std::string::npos) input_error(failure);
    if (is_panoramas_) {
      folder_->clear(places_.joined);
      join_models(places_.models, places_.joined, photographs);
    }
    const std::size_t n_models = order_models(is_panoramas_ ? places_.joined : places_.models, places_.ordered);
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
      warn_(registered + "; views that are missing leave holes: " + kHowToPhotograph);
    }
    if (!is_new) return;
    folder_->move_aside(places_.sparse);
    folder_->own().move(places_.ordered, places_.sparse);
    folder_->own().remove(places_.models);
    folder_->own().remove(places_.joined);
  }

  const ReconstructOptions& options_;
  const ReconstructProgress& progress_;
  const WarnFn& warn_;
  ScenePlaces places_;
  ReconstructInput input_;
  bool is_panoramas_ = false;
  std::optional<SceneFolder> folder_;
  std::optional<ProgramLog> log_;
  std::optional<ColmapProgram> colmap_;
  std::optional<StageRecord> record_;
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
