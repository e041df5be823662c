#include "scene/scene.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "core/check.h"
#include "core/text.h"
#include "scene/cameras/camera_lens.h"
#include "scene/cameras/undistort.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image_folder.h"
#include "scene/scene_model.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::map<std::string, fs::path> find_photographs(const SceneModel& model, const ImageFolder& folder) {
  std::vector<std::string> names;
  for (const ColmapImage& image : model.model.images) {
    if (model.files.count(image.name) == 0) names.push_back(image.name);
  }
  std::map<std::string, fs::path> files = folder.find_all(names);
  files.insert(model.files.begin(), model.files.end());
  return files;
}

/// Cameras of whole photographs without poses, by camera ID and size of the photograph.
using PhotographCameras = std::map<std::tuple<std::uint32_t, int, int>, Camera>;

/// Returns the camera of the photograph: a pinhole if it is undistorted, or with its lens (SceneOptions::lenses).
Camera training_camera(const ViewSource& source, const std::string& lenses, PhotographCameras& cameras) {
  constexpr double kEnoughUndistorted = 0.9;
  const bool is_panorama = source.file_camera.lens.kind == LensKind::kEquirectangular;
  if (source.file_camera.is_pinhole() || (lenses == "undistort" && !is_panorama)) {
    return source.file_camera.without_lens();
  }
  const auto [known, is_new] = cameras.try_emplace({source.camera_id, source.file_size.width, source.file_size.height});
  if (!is_new) return known->second;
  const Camera native = native_camera(source.file_camera, source.camera_place);
  const bool is_undistorted = lenses == "auto" && !is_panorama && undistorted_share(native) >= kEnoughUndistorted;
  return known->second = is_undistorted ? native.without_lens() : native;
}

// Reads the photograph's header. Photographs may be smaller or larger than their camera. If the sides are swapped, the
// camera belongs to the photograph after it is turned by its EXIF orientation.
ViewSource view_source(const ColmapImage& image, const SceneModel& model, const fs::path& file, int divisor,
                       const SceneOptions& options, PhotographCameras& cameras) {
  const ColmapCamera& camera = model.model.cameras.at(image.camera_id);
  ViewSource source;
  source.name = image.name;
  source.image_id = image.id;
  source.file = file.string();
  source.camera_id = camera.id;
  source.camera_place = model.camera_places.at(camera.id);
  source.file_size = read_image_size(file);
  const ImageSize camera_size{static_cast<int>(camera.width), static_cast<int>(camera.height)};
  if (is_turned(source.file_size, camera_size)) {
    const int orientation = read_orientation(file);
    source.is_on_side = orientation < 5;  // those above swap the sides
    if (!source.is_on_side) {
      source.orientation = orientation;
      std::swap(source.file_size.width, source.file_size.height);
    }
  }
  source.size = training_size(divided_size(source.file_size, divisor), options.resolution);
  source.file_camera =
      camera_of(camera, source.camera_place).scaled_to(source.file_size.width, source.file_size.height);
  source.camera = training_camera(source, options.lenses, cameras).scaled_to(source.size.width, source.size.height);
  source.camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
  return source;
}

// Finds the masks. A mask that the scene names takes precedence over one of the folder, unless a folder was given.
// Returns a warning, or "".
std::string find_masks(const SceneModel& model, const SceneOptions& options, std::vector<ViewSource>& sources) {
  if (options.masks == "none") return "";
  const bool is_asked_for = !options.masks.empty();
  const fs::path folder = find_mask_folder(options.source_path, options.masks);
  bool is_any = false;
  for (ViewSource& source : sources) {
    const auto named = model.masks.find(source.name);
    const bool is_named = named != model.masks.end() && !is_asked_for;
    if (is_named && options.load_images && !is_file(named->second)) {
      input_error(model.file, ": mask_path of the photograph ", source.name,
                  ": file not found: ", named->second.string(), "; restore the file or correct the path");
    }
    source.mask_file = (is_named ? named->second : find_mask(folder, source.name, options.images)).string();
    is_any = is_any || !source.mask_file.empty();
  }
  if (is_any || folder.empty()) return "";
  const std::string text = detail::concat(
      folder.string(), ": no mask for any of the ", sources.size(),
      " photographs (expected a.png, a.jpg.png or a.mask.png for a.jpg, in the same sub-folders); choose another ",
      "folder with --masks");
  if (is_asked_for) input_error(text);
  return text + ", or say that there are none with --masks none";
}

template <class AnyView>
std::vector<Camera> cameras_of(const std::vector<AnyView>& views) {
  std::vector<Camera> cameras;
  cameras.reserve(views.size());
  for (const View& view : views) cameras.push_back(view.camera);
  return cameras;
}

// A single camera this far away would move the frame's origin to where single precision does not separate the others.
void check_distances(const std::vector<ViewSource>& sources, const SceneModel& model) {
  constexpr double kMostTimes = 1e5;  // wrong registrations lie some hundred times as far away
  const std::vector<double> distances = relative_distances(cameras_of(sources), model.points.positions).values;
  const auto farthest =
      static_cast<std::size_t>(std::max_element(distances.begin(), distances.end()) - distances.begin());
  const double times = distances[farthest];
  if (times <= kMostTimes) return;
  input_error(model.file, ": image ", sources[farthest].name, ": expected a camera centre at most ", kMostTimes,
              " times the usual distance from the others, found ", times,
              " times; remove the image from the model or reconstruct the scene again");
}

/// Returns a line that names the training views whose cameras are far from the others, or "".
std::string describe_far_cameras(const std::vector<View>& views, const std::vector<double>& points) {
  const std::vector<double> distances = relative_distances(cameras_of(views), points).values;
  const auto n_far = std::count_if(distances.begin(), distances.end(), [](double times) { return times > kFarTimes; });
  if (n_far == 0) return "";
  const auto farthest =
      static_cast<std::size_t>(std::max_element(distances.begin(), distances.end()) - distances.begin());
  return detail::concat("the camera of ", views[farthest].name, print_to_string(" is %.0f times", distances[farthest]),
                        " as far from the others as usual",
                        n_far > 1 ? detail::concat(", and ", n_far - 1, " more are over ", kFarTimes, " times") : "",
                        "; the radius of the scene counts as ", kMostRadius,
                        " times the usual one; if the camera is registered wrongly, remove it");
}

}  // namespace

double scene_extent(const std::vector<View>& views, const std::vector<double>& points) {
  const double radius = limited_radius(cameras_of(views), points);
  return radius > 0 ? 1.1 * radius : 1.0;
}

Scene load_scene(const SceneOptions& options, const ProgressFn& progress) {
  check_resolution(options.resolution);
  const fs::path source_path = options.source_path;
  if (!holds_scene(source_path)) find_model_folder(source_path);  // reports what is missing
  const ImageFolder folder(source_path, options.images);
  SceneModel model = read_scene_model(options, folder);

  std::vector<ColmapImage>& registered = model.model.images;
  std::sort(registered.begin(), registered.end(),  // the order of the views, and thus of the split
            [](const ColmapImage& a, const ColmapImage& b) { return a.name < b.name; });
  const std::map<std::string, fs::path> files = find_photographs(model, folder);
  std::vector<ViewSource> sources;
  std::vector<std::string> missing;
  PhotographCameras cameras;
  for (const ColmapImage& image : registered) {
    const auto file = files.find(image.name);
    if (file == files.end()) {
      missing.push_back(image.name);
      continue;
    }
    sources.push_back(view_source(image, model, file->second, folder.divisor(), options, cameras));
    if (progress) progress("reading image headers", sources.size(), files.size());
  }
  if (sources.empty()) {
    input_error((source_path / options.images).string(), ": ",
                missing.empty() ? "the model has no registered images; reconstruct the scene again"
                                : detail::concat("none of the ", missing.size(), " registered images found (first: ",
                                                 missing.front(), "); copy them there or choose their folder with -i"));
  }
  check_distances(sources, model);
  const std::string mask_warning = find_masks(model, options, sources);
  const std::shared_ptr<SceneImages> images = options.load_images ? prepare_images(sources, options) : nullptr;

  Scene scene;
  scene.source_path = options.source_path;
  scene.options = options;
  scene.georeference = read_georeference(source_path);
  scene.warnings = model.warnings;
  if (!mask_warning.empty()) scene.warnings.push_back(mask_warning);
  if (!model.points.left_out.empty()) scene.warnings.push_back(model.points.left_out);
  std::vector<std::string> masked_out;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (sources[i].is_masked_out) {
      masked_out.push_back(sources[i].name);
      continue;
    }
    const bool is_held_out = model.split.empty() ? i % kTestEvery == 0 : model.held_out.count(sources[i].name) > 0;
    std::vector<View>& part = options.eval && is_held_out ? scene.test : scene.train;
    part.push_back(sources[i]);  // without the members that only loading needs
    if (images) part.back().image = std::make_shared<ViewImage>(sources[i], images);
    if (options.tracks) part.back().points = std::move(model.visible_points[sources[i].image_id]);
  }
  const bool is_unusable = scene.train.empty() && (options.needs_training_views || scene.test.empty());
  if (is_unusable && masked_out.size() + scene.test.size() == sources.size() && !masked_out.empty()) {
    input_error(sources.front().mask_file, ": masks leave no pixel of any training photograph; black is left out, ",
                "and --invert_masks leaves out white instead");
  }
  if (is_unusable) {
    input_error(options.source_path, ": --eval holds out ",
                model.split.empty() ? detail::concat("every ", kTestEvery, "th image") : "the views of " + model.split,
                ", which leaves none of ", scene.test.size(),
                " to train on; remove --eval, or give b3dgs compare --no_eval");
  }
  const std::vector<View>& views = scene.train.empty() ? scene.test : scene.train;
  scene.extent = scene_extent(views, model.points.positions);
  const std::string far_cameras = describe_far_cameras(views, model.points.positions);
  if (!far_cameras.empty()) scene.warnings.push_back(far_cameras);
  change_frame_of_views(options.frame ? *options.frame : choose_frame(cameras_of(views), model.points.positions),
                        scene);
  scene.points = in_frame(scene.frame, model.points);
  const bool has_points = scene.points.size() > 0, is_resumed = options.frame.has_value();
  if (options.seed_points && options.load_images && !(has_points && is_resumed)) {
    const std::int64_t n_found = add_points_of_photographs(scene, progress);
    std::string& text = model.points_description;
    if (!has_points) {
      text = "found in the photographs, since the scene has none";
    } else if (n_found > 0) {
      text += detail::concat(text.empty() ? "" : "; ", n_found, " found in parts of the photographs without points");
      scene.n_added_points = n_found;
    }
  }
  std::set<std::string> lens_warnings;
  std::set<fs::path> used;
  for (const ViewSource& source : sources) {
    used.insert(source.file);
    if (!source.warning.empty() && lens_warnings.insert(source.warning).second) {
      scene.warnings.push_back(source.warning);
    }
  }
  if (!masked_out.empty()) {
    scene.warnings.push_back(detail::concat("masks leave no pixel of ", masked_out.size(), " of ", sources.size(),
                                            " photographs (first: ", masked_out.front(),
                                            "); training and evaluation leave them out"));
  }
  if (!missing.empty()) {
    scene.warnings.push_back(detail::concat(folder.folder().string(), ": ", missing.size(), " of ", registered.size(),
                                            " registered images not found (first: ", missing.front(),
                                            "); training and evaluation leave them out"));
  }
  if (const std::vector<LeftOutImage>& left_out = model.model.left_out; !left_out.empty()) {
    scene.warnings.push_back(detail::concat(left_out.front().reason, "; training and evaluation leave out ",
                                            left_out.size(), " of ", left_out.size() + registered.size(),
                                            " images (first: ", left_out.front().name, ")"));
  }
  std::vector<const ViewSource*> on_side;
  for (const ViewSource& source : sources) {
    if (source.is_on_side) on_side.push_back(&source);
  }
  if (!on_side.empty()) {
    const ViewSource& first = *on_side.front();
    const ColmapCamera& camera = model.model.cameras.at(first.camera_id);
    scene.warnings.push_back(detail::concat(
        first.file, ": expected the sides of its camera, ", camera.width, " x ", camera.height, " px, found ",
        first.file_size.width, " x ", first.file_size.height, " px, and no EXIF orientation that says how to turn it",
        on_side.size() > 1 ? detail::concat(" (", on_side.size(), " such photographs)") : "",
        "; turn the photograph, or it is stretched"));
  }
  scene.summary = summarize(scene, {options, model, folder, sources, missing, folder.count_others(used)});
  return scene;
}

void change_frame_of_views(const CoordinateFrame& to, Scene& scene) {
  for (std::vector<View>* views : {&scene.train, &scene.test}) {
    for (View& view : *views) view.camera = change_frame(scene.frame, to, view.camera);
  }
  scene.extent *= scene.frame.unit / to.unit;
  scene.frame = to;
}

std::optional<std::array<double, 3>> scene_up(const Scene& scene) {
  if (scene.georeference) return Georeference::kUp;
  std::vector<Camera> cameras;
  for (const std::vector<View>* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) cameras.push_back(view.camera);
  }
  return up_direction(cameras);
}

std::string scene_name(const std::string& source_path) {
  if (source_path.empty()) return "";
  const fs::path scene = fs::absolute(source_path).lexically_normal();
  return (scene.has_filename() ? scene : scene.parent_path()).filename().string();
}

}  // namespace b3dgs
