#include <algorithm>
#include <cmath>
#include <tuple>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "scene/cameras/camera.h"
#include "scene/images/image_folder.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using transforms::Json;

std::string name_of_path(const std::string& file_path) {
  std::string path = file_path;
  std::replace(path.begin(), path.end(), '\\', '/');
  fs::path name;
  for (const fs::path& part : fs::path(path).relative_path().lexically_normal()) {
    if (part != ".." && part != "." && !part.empty()) name /= part;
  }
  if (name.empty()) return "";
  return has_image_extension(name) ? name.generic_string() : name.generic_string() + ".png";
}

// Relative to the folder of the file, with the extension that the name has.
fs::path file_of_path(const fs::path& file, const std::string& file_path) {
  const fs::path path = file.parent_path() / fs::path(file_path);
  return has_image_extension(path) ? path : fs::path(path.string() + ".png");
}

// As [4, 4], or [3, 4] without the last row.
OpenGlMatrix matrix_of(const Json& frame, const std::string& place) {
  constexpr const char* kExpected = "expected transform_matrix to be a list of 4 rows of 4 numbers, found ";
  const auto found = frame.find("transform_matrix");
  if (found == frame.end()) input_error(place, ": ", kExpected, "none");
  if (!found->is_array() || (found->size() != 3 && found->size() != 4)) {
    input_error(place, ": ", kExpected, json_excerpt(*found));
  }
  OpenGlMatrix matrix{};
  matrix[15] = 1;
  for (std::size_t row = 0; row < found->size(); ++row) {
    const Json& values = (*found)[row];
    if (!values.is_array() || values.size() != 4)
      input_error(place, ": ", kExpected, json_excerpt(values), " as a row");
    for (std::size_t column = 0; column < 4; ++column) {
      matrix[4 * row + column] = transforms::finite_number(values[column], "a number of transform_matrix", place);
    }
  }
  return matrix;
}

std::string path_at(const Json& json, const char* key, const std::string& place) {
  const auto found = json.find(key);
  if (found == json.end() || found->is_null()) return "";
  if (!found->is_string()) input_error(place, ": expected ", key, " to be a path, found ", json_excerpt(*found));
  std::string path = found->get<std::string>();
  if (path.find('\0') != std::string::npos) input_error(place, ": ", key, " contains a zero byte");
  return path;
}

void add_names(const Json& json, const char* key, const std::string& place, std::set<std::string>& names) {
  const auto found = json.find(key);
  if (found == json.end()) return;
  if (!found->is_array()) input_error(place, ": expected ", key, " to be a list, found ", json_excerpt(*found));
  for (const Json& name : *found) {
    if (!name.is_string()) input_error(place, ": expected paths in ", key, ", found ", json_excerpt(name));
    names.insert(name_of_path(name.get<std::string>()));
  }
}

// Adds frames, and a camera for each new set of intrinsics.
class FrameReader {
 public:
  FrameReader(const Json& json, const fs::path& file, const PhotographSizeFn& size_of, TransformsModel& model)
      : json_(json), file_(file), size_of_(size_of), model_(model) {
    for (const auto& [id, camera] : model.model.cameras) ids_[key_of(camera)] = id;
    for (const ColmapImage& image : model.model.images) names_.insert(image.name);
  }

  void read() {
    const auto frames = json_.find("frames");
    if (frames == json_.end() || !frames->is_array() || frames->empty()) {
      input_error(file_.string(), ": expected a list \"frames\" with an entry for each photograph, found ",
                  frames == json_.end() ? "none" : json_excerpt(*frames));
    }
    std::vector<std::size_t> without_camera;  // of images in the model, whose photographs are missing
    for (std::size_t i = 0; i < frames->size(); ++i) {
      if (!read_frame((*frames)[i], i)) without_camera.push_back(model_.model.images.size() - 1);
    }
    for (const std::size_t image : without_camera) model_.model.images[image].camera_id = any_camera();
  }

 private:
  using CameraKey = std::tuple<CameraModel, std::uint64_t, std::uint64_t, std::vector<double>>;

  static CameraKey key_of(const ColmapCamera& camera) {
    return {camera.model, camera.width, camera.height, camera.params};
  }

  // False if its camera is not known because its photograph is missing.
  bool read_frame(const Json& frame, std::size_t index) {
    std::string place = detail::concat(file_.string(), ": frame ", index);
    if (!frame.is_object()) input_error(place, ": expected an object, found ", json_excerpt(frame));
    const std::string file_path = path_at(frame, "file_path", place);
    const std::string name = name_of_path(file_path);
    if (name.empty()) input_error(place, ": expected file_path to name a photograph, found \"", file_path, "\"");
    place += " (" + file_path.substr(0, 100) + ")";
    if (detail::one_line(name) != name) {  // names are printed, and outputs are named after them
      input_error(place, ": expected a file_path without control characters; rename the photograph");
    }
    if (!names_.insert(name).second) {
      input_error(place, ": the photograph ", name, " is in two frames; remove one of them");
    }
    ColmapImage image;
    image.id = static_cast<std::uint32_t>(model_.model.images.size() + 1);
    image.name = name;
    const Pose pose = pose_from_opengl(matrix_of(frame, place), place + ": transform_matrix");
    image.quat = quaternion_from_rotation(pose.rotation);
    image.translation = pose.translation;
    model_.files[name] = file_of_path(file_, file_path);
    if (const std::string mask = path_at(frame, "mask_path", place); !mask.empty()) {
      model_.masks[name] = file_.parent_path() / mask;
    }
    const transforms::FrameValues values(frame, json_, place);
    std::optional<ColmapCamera> camera = transforms::camera_of_frame(values, [&] { return size_of_(name); });
    if (camera) image.camera_id = id_of(std::move(*camera), place);
    model_.model.images.push_back(std::move(image));
    return camera.has_value();
  }

  std::uint32_t id_of(ColmapCamera camera, const std::string& place) {
    const auto [known, is_new] = ids_.emplace(key_of(camera), static_cast<std::uint32_t>(ids_.size() + 1));
    if (is_new) {
      camera.id = known->second;
      model_.camera_places[camera.id] = place;
      model_.model.cameras[camera.id] = std::move(camera);
    }
    return known->second;
  }

  // For frames that will be left out: their size is not known.
  std::uint32_t any_camera() {
    if (!ids_.empty()) return ids_.begin()->second;
    ColmapCamera camera;
    camera.width = camera.height = 1;
    camera.params = {1, 1, 0.5, 0.5};
    return id_of(camera, file_.string());
  }

  const Json& json_;
  const fs::path& file_;
  const PhotographSizeFn& size_of_;
  TransformsModel& model_;
  std::map<CameraKey, std::uint32_t> ids_;
  std::set<std::string> names_;
};

}  // namespace

TransformsFiles find_transforms(const fs::path& source) {
  TransformsFiles files;
  const fs::path all = source / "transforms.json", train = source / "transforms_train.json";
  if (is_file(train)) {
    files.train = train;
    if (is_file(all)) files.notes.push_back("transforms.json is not used, because there is a transforms_train.json");
  } else if (is_file(all)) {
    files.train = all;
  }
  if (files.train != train) return files;  // a transforms.json has all views
  for (const char* name : {"transforms_test.json", "transforms_val.json"}) {
    if (!is_file(source / name)) continue;
    if (files.held_out.empty()) {
      files.held_out = source / name;
    } else {
      files.notes.push_back(
          detail::concat(name, " is not used, because there is a ", files.held_out.filename().string()));
    }
  }
  return files;
}

void read_transforms(const fs::path& file, const PhotographSizeFn& size_of, TransformsModel& model) {
  FileReader reader(file);
  std::string text(reader.remaining(), '\0');
  reader.read_bytes(text.data(), text.size());
  read_transforms(text, file, size_of, model);
}

void read_transforms(std::string_view text, const fs::path& file, const PhotographSizeFn& size_of,
                     TransformsModel& model) {
  const std::string place = file.string();
  const Json json = parse_json(text, /*ignore_comments=*/true);
  if (!json.is_object()) {
    input_error(
        place, ": expected a JSON object with \"frames\", found ",
        json.is_discarded() ? "text that is not valid JSON (truncated, or with NaN or Infinity?)" : json_excerpt(json),
        "; export the scene again");
  }
  FrameReader(json, file, size_of, model).read();
  add_names(json, "test_filenames", place, model.listed_as_test);
  add_names(json, "val_filenames", place, model.listed_as_validation);
  if (const std::string points = path_at(json, "ply_file_path", place); !points.empty() && model.points.empty()) {
    model.points = file.parent_path() / points;
  }
}

}  // namespace b3dgs
