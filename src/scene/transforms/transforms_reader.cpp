#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "core/check.h"
#include "core/files/unicode_names.h"
#include "core/vec.h"
#include "scene/images/image_folder.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kPanorama = "EQUIRECTANGULAR";

bool is_fisheye(const JsonValues& values, const std::string& model) {
  // COLMAP's names, which nerfstudio writes too.
  constexpr std::array kModels{"SIMPLE_PINHOLE", "PINHOLE",        "SIMPLE_RADIAL",         "RADIAL",        "OPENCV",
                               "FULL_OPENCV",    "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"};
  if (model.empty()) return values.boolean("is_fisheye");
  std::string names;
  for (const char* name : kModels) {
    if (model == name) return model.find("FISHEYE") != std::string::npos;
    names += std::string(name) + ", ";
  }
  input_error(values.place(), ": unsupported camera_model \"", model.substr(0, 40), "\", expected one of ", names,
              kPanorama, "; convert the photographs to perspective views first");
}

// Returns fx and fy, in px.
std::array<double, 2> focal_lengths(const JsonValues& values, ImageSize size) {
  const auto from_angle = [&](const char* key, int side) -> std::optional<double> {
    const std::optional<double> angle = values.number(key);
    if (!angle) return std::nullopt;
    if (!(*angle > 0 && *angle < kPi)) {
      input_error(values.place(), ": expected ", key, " above 0 and below pi (radians), found ", *angle);
    }
    return 0.5 * side / std::tan(0.5 * *angle);
  };
  std::optional<double> fx = values.number("fl_x"), fy = values.number("fl_y");
  if (!fx && !fy) {
    fx = from_angle("camera_angle_x", size.width);
    fy = from_angle("camera_angle_y", size.height);
  }
  if (!fx && !fy) {
    input_error(values.place(), ": expected a focal length as fl_x (px) or camera_angle_x (radians), found neither");
  }
  return {fx.value_or(fy.value_or(0)), fy.value_or(fx.value_or(0))};
}

ColmapCamera camera_of_frame(const JsonValues& values, ImageSize size) {
  const std::string model = values.text("camera_model");
  ColmapCamera camera;
  camera.width = static_cast<std::uint64_t>(size.width);
  camera.height = static_cast<std::uint64_t>(size.height);
  if (model == kPanorama) {
    camera.model = CameraModel::kEquirectangular;
    camera.params = {static_cast<double>(size.width), static_cast<double>(size.height)};
    return camera;
  }
  const bool is_fisheye_camera = is_fisheye(values, model);
  const auto [fx, fy] = focal_lengths(values, size);
  const auto coefficient = [&](const char* key) { return values.number(key).value_or(0); };
  const double k1 = coefficient("k1"), k2 = coefficient("k2"), k3 = coefficient("k3"), k4 = coefficient("k4"),
               k5 = coefficient("k5"), k6 = coefficient("k6"), p1 = coefficient("p1"), p2 = coefficient("p2");
  std::vector<double> coefficients;
  if (is_fisheye_camera) {
    camera.model = CameraModel::kOpenCvFisheye;
    coefficients = {k1, k2, k3, k4};
  } else if (model == "FULL_OPENCV" || (k3 != 0 && k4 == 0 && k5 == 0 && k6 == 0)) {
    camera.model = CameraModel::kFullOpenCv;
    coefficients = {k1, k2, p1, p2, k3, k4, k5, k6};
  } else if (k4 != 0 || k5 != 0 || k6 != 0) {
    // Programs do not agree whether k4 multiplies r^8 or divides by 1 + k4 r^2.
    input_error(values.place(), ": k4 to k6 of a perspective camera need the camera_model FULL_OPENCV, found ",
                model.empty() ? "none" : model, " and k4 ", k4);
  } else if (k1 != 0 || k2 != 0 || p1 != 0 || p2 != 0) {
    camera.model = CameraModel::kOpenCv;
    coefficients = {k1, k2, p1, p2};
  }
  camera.params = {fx, fy, values.number("cx").value_or(0.5 * size.width),
                   values.number("cy").value_or(0.5 * size.height)};
  camera.params.insert(camera.params.end(), coefficients.begin(), coefficients.end());
  return camera;
}

// Windows separates folders by '\\'.
fs::path path_of(std::string path) {
  std::replace(path.begin(), path.end(), '\\', '/');
  return path;
}

// Returns the file at a path that is relative to the file of the scene.
fs::path file_at(const fs::path& scene_file, const fs::path& path) {
  const fs::path file = find_in_any_form(scene_file.parent_path(), path.string());
  return file.empty() ? scene_file.parent_path() / path : file;
}

std::string name_of_path(const std::string& path) {
  fs::path name;
  for (const fs::path& part : path_of(path).relative_path().lexically_normal()) {
    if (part != ".." && part != "." && !part.empty()) name /= part;
  }
  return name.generic_string() + (name.empty() || has_image_extension(name) ? "" : ".png");
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
  FrameReader(const Json& json, const fs::path& file, const PhotographSizesFn& sizes_of, TransformsModel& model)
      : json_(json), file_(file), sizes_of_(sizes_of), model_(model) {
    for (const auto& [id, camera] : model.model.cameras) ids_[key_of(camera)] = id;
    for (const ColmapImage& image : model.model.images) names_.insert(image.name);
  }

  /// Reads a frame, or leaves it out if it has an UnusableValue.
  void read_frame(const Json& frame, std::size_t index) {
    try {
      add_frame(frame, index);
    } catch (const UnusableValue& error) {
      model_.model.left_out.push_back({name_of_path(frame.at("file_path").get<std::string>()), error.what()});
    }
  }

 private:
  void add_frame(const Json& frame, std::size_t index) {
    std::string place = detail::concat(file_.string(), ": frame ", index);
    if (!frame.is_object()) input_error(place, ": expected an object, found ", json_excerpt(frame));
    const std::string file_path = JsonValues(frame, frame, place).text("file_path");
    const std::string name = name_of_path(file_path);
    if (name.empty()) input_error(place, ": expected file_path to name a photograph, found \"", file_path, "\"");
    place += " (" + file_path.substr(0, 100) + ")";
    if (detail::has_control_characters(name)) {  // names are printed, and outputs are named after them
      input_error(place, ": expected a file_path without control characters; rename the photograph");
    }
    if (!names_.insert(name).second) {
      input_error(place, ": the photograph ", name, " is in two frames; remove one of them");
    }
    const JsonValues own(frame, frame, place), values(frame, json_, place);
    const Pose pose = pose_of(own);
    const fs::path path = path_of(file_path);  // gets the extension of the name
    model_.files[name] = file_at(file_, has_image_extension(path) ? path : fs::path(path.string() + ".png"));
    if (const std::string mask = own.text("mask_path"); !mask.empty())
      model_.masks[name] = file_at(file_, path_of(mask));
    const std::optional<ImageSize> size = camera_size(values, name);
    const std::uint32_t camera_id = size ? id_of(camera_of_frame(values, *size), place) : 0;
    const auto id = static_cast<std::uint32_t>(model_.model.images.size() + 1);
    model_.model.images.push_back({id, quaternion_from_rotation(pose.rotation), pose.translation, camera_id, name});
  }

  static Pose pose_of(const JsonValues& frame) {
    const OpenGlMatrix matrix = frame.matrix("transform_matrix");
    try {
      return pose_from_opengl(matrix, frame.place() + ": transform_matrix");
    } catch (const InputError& error) {
      throw UnusableValue(error.what());
    }
  }

  using CameraKey = std::tuple<CameraModel, std::uint64_t, std::uint64_t, std::vector<double>>;

  static CameraKey key_of(const ColmapCamera& camera) {
    return {camera.model, camera.width, camera.height, camera.params};
  }

  // Returns the size that intrinsics in px belong to, or nothing if there is no photograph.
  std::optional<ImageSize> camera_size(const JsonValues& values, const std::string& name) const {
    const std::optional<int> width = values.side("w"), height = values.side("h");
    if (width && height) return ImageSize{*width, *height};
    const auto [named, used] = sizes_of_(name);
    const std::optional<double> cx = values.number("cx"), cy = values.number("cy");
    if (named || !used) {
      // If the principal point is nearer to the centre of the photograph turned by 90 degrees, like that of a phone
      // held upright, it belongs to the turned one.
      const auto is_nearer = [](double center, int side, int other) {
        return std::abs(2 * center - side) < std::abs(2 * center - other);
      };
      const bool is_turned = named && cx && cy && is_nearer(*cx, named->height, named->width) &&
                             is_nearer(*cy, named->width, named->height);
      return is_turned ? ImageSize{named->height, named->width} : named;
    }
    if (!cx && !cy && !values.number("fl_x") && !values.number("fl_y")) return used;
    // The photograph in use may have been reduced. The principal point is near the centre of the original. Returns 0 if
    // the side of the original is unknown, and -1 if it is not a multiple.
    const auto reduction = [](std::optional<int> side, std::optional<double> center, int used_side) {
      constexpr double kOffCenter = 0.03;  // of the side: twice the distance of the principal point from the centre
      if (!side && !center) return 0.0;
      const double original = side ? *side : 2 * *center, whole = std::round(original / used_side);
      const double rounding = whole, tolerance = rounding + (side ? 0 : kOffCenter * whole * used_side);
      return std::abs(original - whole * used_side) <= tolerance ? whole : -1.0;
    };
    const double across = reduction(width, cx, used->width), down = reduction(height, cy, used->height);
    const double most = static_cast<double>(kMaxImageSide) / std::max(used->width, used->height);
    const double factor = std::max(across, down);
    if (!(factor >= 1 && factor <= most) || (across != 0 && down != 0 && across != down)) {
      input_error(values.place(), ": expected w and h, because fl_x and fl_y are in px and the photograph that ",
                  "file_path names is missing, found only another photograph of ", used->width, " x ", used->height,
                  " px; add w and h, the size of the photograph that fl_x was measured in");
    }
    const auto n = static_cast<int>(factor);
    return ImageSize{n * used->width, n * used->height};
  }

  std::uint32_t id_of(ColmapCamera camera, const std::string& place) {
    const auto [known, is_new] = ids_.emplace(key_of(camera), static_cast<std::uint32_t>(ids_.size() + 1));
    if (is_new) {
      camera_of(camera, place);  // checks its values
      camera.id = known->second;
      model_.camera_places[camera.id] = place;
      model_.model.cameras[camera.id] = std::move(camera);
    }
    return known->second;
  }

  const Json& json_;
  const fs::path& file_;
  const PhotographSizesFn& sizes_of_;
  TransformsModel& model_;
  std::map<CameraKey, std::uint32_t> ids_;
  std::set<std::string> names_;
};

// These are not JSON, but Python and C write them.
constexpr std::array kNotFinite{"NaN", "Infinity", "-Infinity", "nan", "-nan", "inf", "-inf"};

bool is_not_finite(const Json& json) {
  return json.is_string() &&
         std::find(kNotFinite.begin(), kNotFinite.end(), json.get<std::string>()) != kNotFinite.end();
}

/// Returns the text, which may have comments, with quotes around numbers that are not finite.
std::string with_quotes(std::string_view text) {
  std::string quoted;
  bool is_inside = false;  // inside a string
  for (std::size_t at = 0; at < text.size(); ++at) {
    const auto* const word = std::find_if(kNotFinite.begin(), kNotFinite.end(), [&](std::string_view name) {
      return !is_inside && text.substr(at, name.size()) == name;
    });
    if (word != kNotFinite.end()) {
      quoted += detail::concat('"', *word, '"');
      at += std::string_view(*word).size() - 1;
      continue;
    }
    const std::string_view next = text.substr(at, 2);
    if (!is_inside && (next == "//" || next == "/*")) {
      const std::size_t end = text.find(next == "//" ? "\n" : "*/", at + 2);
      const std::string_view comment = text.substr(at, end == std::string_view::npos ? end : end - at);
      quoted += comment;
      at += comment.size() - 1;
      continue;
    }
    quoted += text[at];
    if (is_inside && text[at] == '\\' && at + 1 < text.size()) {
      quoted += text[++at];
    } else if (text[at] == '"') {
      is_inside = !is_inside;
    }
  }
  return quoted;
}

[[noreturn]] void fail_not_finite(const std::string& place, const char* key, const Json& found) {
  throw UnusableValue(detail::one_line(detail::concat(place, ": expected ", key, " to be finite, found ",
                                                      found.get<std::string>(), "; remove the frame or correct it")));
}

}  // namespace

const Json* JsonValues::find(const char* key, bool (Json::*is_expected)() const noexcept, const char* expected) const {
  for (const Json* json : {&object_, &other_}) {
    const auto found = json->find(key);
    if (found == json->end() || found->is_null()) continue;
    if (((*found).*is_expected)()) return &*found;
    if (is_expected == &Json::is_number && is_not_finite(*found)) fail_not_finite(place_, key, *found);
    input_error(place_, ": expected ", key, " to be ", expected, ", found ", json_excerpt(*found));
  }
  return nullptr;
}

std::optional<double> JsonValues::number(const char* key) const {
  const Json* json = find(key, &Json::is_number, "a number");
  if (json == nullptr) return std::nullopt;
  const auto value = json->get<double>();
  if (std::abs(value) <= kMaxCoordinate) return value;
  input_error(place_, ": expected ", key, " to be a number of at most ", kMaxCoordinate, ", found ", value);
}

std::optional<double> JsonValues::positive(const char* key, double max) const {
  const std::optional<double> value = number(key);
  if (!value || (*value > 0 && *value <= max)) return value;
  input_error(place_, ": expected ", key, " above 0 and at most ", max, ", found ", *value);
}

std::optional<int> JsonValues::side(const char* key) const {
  const Json* json = find(key, &Json::is_number, "a number");
  if (json == nullptr) return std::nullopt;
  const auto value = json->get<double>();
  if (value >= 1 && value <= kMaxImageSide && value == std::floor(value)) return static_cast<int>(value);
  input_error(place_, ": expected ", key, " to be a whole number of 1 to ", kMaxImageSide, " px, found ", value);
}

bool JsonValues::boolean(const char* key) const {
  const Json* json = find(key, &Json::is_boolean, "true or false");
  return json != nullptr && json->get<bool>();
}

std::string JsonValues::text(const char* key) const {
  const Json* json = find(key, &Json::is_string, "a text");
  if (json == nullptr) return "";
  auto text = json->get<std::string>();
  if (text.find('\0') != std::string::npos) input_error(place_, ": ", key, " contains a zero byte");
  return text;
}

OpenGlMatrix JsonValues::matrix(const char* key) const {
  const Json* json = find(key, &Json::is_array, "4 rows of 4 numbers");
  if (json == nullptr) input_error(place_, ": expected ", key, " of 4 rows of 4 numbers, found none");
  std::vector<double> numbers;
  bool is_matrix = true;
  const auto take = [&](const Json& value) {
    if (is_not_finite(value)) fail_not_finite(place_, key, value);
    is_matrix = is_matrix && value.is_number();
    if (is_matrix) numbers.push_back(value.get<double>());
  };
  for (const Json& row : *json) {
    is_matrix = is_matrix && (!row.is_array() || row.size() == 4);
    if (!row.is_array()) take(row);
    for (std::size_t i = 0; row.is_array() && i < row.size(); ++i) take(row[i]);
  }
  if (!is_matrix || (numbers.size() != 12 && numbers.size() != 16)) {
    input_error(place_, ": expected ", key, " of 4 rows of 4 numbers, found ", json_excerpt(*json));
  }
  OpenGlMatrix matrix{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
  std::copy(numbers.begin(), numbers.end(), matrix.begin());
  return matrix;
}

TransformsFiles find_transforms(const fs::path& source) {
  TransformsFiles files;
  const fs::path all = source / "transforms.json", train = source / "transforms_train.json";
  if (!is_file(train)) {
    if (is_file(all)) files.train = all;  // has all views
    return files;
  }
  files.train = train;
  if (is_file(all)) files.notes.push_back("transforms.json is not used, because there is a transforms_train.json");
  for (const char* name : {"transforms_test.json", "transforms_val.json"}) {
    if (!is_file(source / name)) continue;
    if (files.held_out.empty()) {
      files.held_out = source / name;
    } else {
      files.notes.push_back(detail::concat(name, " is not used, because there is a transforms_test.json"));
    }
  }
  return files;
}

Json parse_json_with_extras(std::string_view text, const std::string& place) {
  Json json = parse_json(text, /*ignore_comments=*/true);
  if (!json.is_discarded()) return json;
  const std::string quoted = with_quotes(text);
  json = parse_json(quoted, /*ignore_comments=*/true);
  if (json.is_discarded())
    input_error(place, ": not valid JSON: ", json_damage(quoted), "; correct it or export it again");
  return json;
}

void read_transforms(std::string_view text, const fs::path& file, const PhotographSizesFn& sizes_of,
                     TransformsModel& model) {
  const std::string place = file.string();
  const Json json = parse_json_with_extras(text, place);
  if (!json.is_object()) {
    input_error(place, ": expected a JSON object with \"frames\", found ", json_excerpt(json),
                "; export the scene again");
  }
  const auto frames = json.find("frames");
  if (frames == json.end() || !frames->is_array() || frames->empty()) {
    input_error(place, ": expected a list \"frames\" with an entry for each photograph, found ",
                frames == json.end() ? "none" : json_excerpt(*frames));
  }
  FrameReader reader(json, file, sizes_of, model);
  for (std::size_t i = 0; i < frames->size(); ++i) reader.read_frame((*frames)[i], i);
  if (model.model.images.empty()) input_error(model.model.left_out.front().reason);
  add_names(json, "train_filenames", place, model.listed_for_training);
  add_names(json, "test_filenames", place, model.listed_as_test);
  add_names(json, "val_filenames", place, model.listed_as_validation);
  const std::string points = JsonValues(json, json, place).text("ply_file_path");
  if (!points.empty() && model.points.empty()) model.points = file_at(file, path_of(points));
}

}  // namespace b3dgs
