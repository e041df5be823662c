// COLMAP's files. Binary files are a 64-bit count, then records without padding, little-endian. Text files have one
// line for each camera and point, two for each image, and comments after '#'. Counts in these comments are ignored,
// because some programs write wrong ones. Each kind of record is described once, for both formats and for reading and
// writing. Values are checked so that everything that read_colmap_model()
// returns is usable.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <type_traits>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/text.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

fs::path file_of(const fs::path& folder, const char* stem, ColmapFormat format) {
  return folder / (std::string(stem) + (format == ColmapFormat::kBinary ? ".bin" : ".txt"));
}

/// A kind of record.
struct Kind {
  const char *one, *many;
  std::uint64_t min_bytes;
  const char* header;
};
template <class Record>
constexpr Kind kKind{};
template <>  // has the parameters of EQUIRECTANGULAR
constexpr Kind kKind<ColmapCamera>{
    "camera", "cameras", 4 + 4 + 8 + 8 + 2 * 8,
    "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"};
template <>  // has a name of one letter and no 2D points
constexpr Kind kKind<ColmapImage>{
    "image", "images", 4 + 4 * 8 + 3 * 8 + 4 + 2 + 8,
    "# Image list with two lines of data per image:\n"
    "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n"};
template <>  // has no track
constexpr Kind kKind<ColmapPoint>{"point", "points", 8 + 3 * 8 + 3 + 8 + 8,
                                  "# 3D point list with one line of data per point:\n"
                                  "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"};

template <class Archive, class Values>
void visit_numbers(Archive& archive, Values& values, const char* what) {
  for (auto& value : values) archive.number(value, what);
}

template <class Archive>
void visit(Archive& archive, ColmapCamera& camera) {
  archive.number(camera.id, "the camera's ID");
  archive.model(camera);
  archive.number(camera.width, "the camera's width");
  archive.number(camera.height, "the camera's height");
  archive.parameters(camera);
}

template <class Archive>
void visit(Archive& archive, ColmapImage& image) {
  archive.number(image.id, "the image's ID");
  visit_numbers(archive, image.quat, "the quaternion qw, qx, qy, qz");
  visit_numbers(archive, image.translation, "the translation tx, ty, tz");
  archive.number(image.camera_id, "the ID of the image's camera");
  archive.name(image.name);
  archive.points_2d(image);
}

template <class Archive>
void visit(Archive& archive, ColmapPoint& point) {
  archive.number(point.id, "the point's ID");
  visit_numbers(archive, point.position, "the position x, y, z");
  visit_numbers(archive, point.color, "the colour r, g, b from 0 to 255");
  archive.number(point.error, "the reprojection error");
  archive.track(point);
}

constexpr std::uint64_t kPoint2dBytes = 2 * 8 + 8, kTrackElementBytes = 2 * 4;

struct BinaryReader {
  FileReader& file;
  Observations observations;

  template <class T>
  void number(T& value, const char*) {
    value = file.read<T>();
  }
  void model(ColmapCamera& camera) {
    camera.model = camera_model_from_id(file.read<std::int32_t>(), detail::concat(file.name(), ": camera ", camera.id));
  }
  void parameters(ColmapCamera& camera) {
    camera.params.resize(camera_model_param_count(camera.model));
    visit_numbers(*this, camera.params, "");
  }
  void name(std::string& name) { name = file.read_c_string(); }
  void points_2d(ColmapImage& image) {
    keep_or_skip(n_elements("2D points", kPoint2dBytes) * kPoint2dBytes, image.points_2d);
  }
  void track(ColmapPoint& point) {
    const std::uint64_t length = n_elements("track elements", kTrackElementBytes);
    if (observations != Observations::kTracks) return keep_or_skip(length * kTrackElementBytes, point.track);
    point.image_ids.resize(length);
    for (std::uint32_t& image : point.image_ids) {
      image = file.read<std::uint32_t>();
      file.skip(sizeof(std::uint32_t));  // the index of its 2D point
    }
  }
  void keep_or_skip(std::uint64_t n_bytes, std::string& bytes) {
    if (observations != Observations::kAll) return file.skip(n_bytes);
    bytes.resize(n_bytes);
    file.read_bytes(bytes.data(), n_bytes);
  }
  std::uint64_t n_elements(const char* kind, std::uint64_t bytes_each) {
    const auto count = file.read<std::uint64_t>();
    file.expect_records(kind, count, bytes_each);
    return count;
  }
};

// Returns whether the word is NaN or an infinity as older programs on Windows write them: 1.#QNAN, -1.#IND, 1.#INF.
bool is_windows_nan(std::string_view word) {
  if (!word.empty() && (word[0] == '-' || word[0] == '+')) word.remove_prefix(1);
  return word.substr(0, 3) == "1.#";
}

// An image's second line has x, y and the ID of a 3D point for each 2D point. Without this check, a file that lacks the
// second lines would silently lose every other image. If the names of images are numbers too, the number of words
// decides, because a first line has 10 words.
void check_points_2d_line(const FileReader& file, std::string_view line, const ColmapImage& image) {
  const auto is_number = [](std::string_view word) {
    if (word.find_first_not_of("0123456789+-.eE") == std::string_view::npos || is_windows_nan(word)) return true;
    word.remove_prefix(word[0] == '-' || word[0] == '+' ? 1 : 0);
    const std::string start = lower_case(std::string(word.substr(0, 3)));
    return start == "nan" || start == "inf";
  };
  std::size_t n_words = 0;
  std::string found;
  for (TextFields fields(line); !fields.empty() && found.empty();) {
    const std::string_view word = fields.word();
    ++n_words;
    if (!is_number(word)) found = detail::concat('"', word.substr(0, 40), '"');
  }
  if (found.empty() && n_words % 3 == 0) return;
  input_error(file.place(), ": expected the 2D points of image ", image.id, " (x, y and a point's ID for each, or an ",
              "empty line), found ", found.empty() ? detail::concat(n_words, " numbers") : found,
              "; add a second line for each image, which may be empty");
}

/// Reads the values of one line.
struct TextReader {
  FileReader& file;
  Observations observations;
  TextFields fields;

  template <class T>
  void number(T& value, const char* what) {
    if constexpr (std::is_floating_point_v<T>) {
      TextFields rest = fields;
      if (is_windows_nan(rest.word())) {
        value = std::numeric_limits<T>::quiet_NaN();
        fields = rest;
        return;
      }
    }
    value = fields.number<T>(what, [this] { return file.place(); });
  }
  void model(ColmapCamera& camera) { camera.model = camera_model_from_name(std::string(fields.word()), file.place()); }
  void parameters(ColmapCamera& camera) {
    camera.params.resize(camera_model_param_count(camera.model));
    const std::string expected =
        detail::concat("the ", camera.params.size(), " parameters ", camera_model_params(camera.model), " of ",
                       camera_model_name(camera.model));
    visit_numbers(*this, camera.params, expected.c_str());
    if (fields.empty()) return;
    input_error(file.place(), ": expected only ", expected, ", found \"", fields.rest(), "\" after them");
  }
  void name(std::string& name) {
    name = fields.rest();
    if (name.empty()) input_error(file.place(), ": expected the image's name, found the end of the line");
  }
  void points_2d(ColmapImage& image) {
    std::string_view line;
    if (!file.read_line(line)) return;
    check_points_2d_line(file, line, image);
    if (observations == Observations::kAll) image.points_2d = line;
  }
  void track(ColmapPoint& point) {
    if (observations == Observations::kAll) point.track = fields.rest();
    while (observations == Observations::kTracks && !fields.empty()) {
      std::uint32_t index = 0;
      number(point.image_ids.emplace_back(), "the ID of an image in the track");
      number(index, "the index of a 2D point in the track");
    }
  }
};

template <class Record>
std::vector<Record> read_records(FileReader& file, ColmapFormat format,
                                 Observations observations = Observations::kNone) {
  std::vector<Record> records;
  if (format == ColmapFormat::kBinary) {
    BinaryReader reader{file, observations};
    records.resize(reader.n_elements(kKind<Record>.many, kKind<Record>.min_bytes));
    for (std::uint64_t i = 0; i < records.size(); ++i) {
      file.begin_record(kKind<Record>.one, i, records.size());
      visit(reader, records[i]);
    }
    file.expect_end();
    return records;
  }
  for (std::string_view line; file.read_line(line);) {
    const std::size_t first = line.find_first_not_of(" \t");
    if (first == std::string_view::npos || line[first] == '#') continue;
    TextReader reader{file, observations, TextFields(line)};
    visit(reader, records.emplace_back());
  }
  return records;
}

struct BinaryWriter {
  std::string bytes;

  template <class T>
  void number(T value, const char* = "") {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
  }
  void model(const ColmapCamera& camera) { number(static_cast<std::int32_t>(camera.model)); }
  void parameters(const ColmapCamera& camera) { visit_numbers(*this, camera.params, ""); }
  void name(const std::string& name) { bytes.append(name).push_back('\0'); }
  void points_2d(const ColmapImage& image) { elements(image.points_2d, kPoint2dBytes); }
  void track(const ColmapPoint& point) { elements(point.track, kTrackElementBytes); }
  void elements(const std::string& elements, std::uint64_t bytes_each) {
    number(std::uint64_t{elements.size() / bytes_each});
    bytes += elements;
  }
};

struct TextWriter {
  std::string text;

  void word(const std::string& word) { text += (text.back() == '\n' ? "" : " ") + word; }
  template <class T>
  void number(T value, const char*) {
    if constexpr (std::is_floating_point_v<T>) {
      char digits[32];
      std::snprintf(digits, sizeof(digits), "%.17g", value);  // enough to read back the same double
      word(digits);
    } else {
      word(std::to_string(value));
    }
  }
  void model(const ColmapCamera& camera) { word(camera_model_name(camera.model)); }
  void parameters(const ColmapCamera& camera) { visit_numbers(*this, camera.params, ""); }
  void name(const std::string& name) { word(name); }
  void points_2d(const ColmapImage& image) { text += "\n" + image.points_2d; }
  void track(const ColmapPoint& point) {
    if (!point.track.empty()) word(point.track);
  }
};

template <class Record>
std::string content_of(const std::vector<Record>& records, ColmapFormat format) {
  if (format == ColmapFormat::kBinary) {
    BinaryWriter writer;
    writer.number(static_cast<std::uint64_t>(records.size()));
    for (Record record : records) visit(writer, record);
    return std::move(writer.bytes);
  }
  TextWriter writer{
      detail::concat(kKind<Record>.header, "# Number of ", kKind<Record>.many, ": ", records.size(), "\n")};
  for (Record record : records) {
    visit(writer, record);
    writer.text += "\n";
  }
  return std::move(writer.text);
}

template <class Record, class Key>
void expect_different(const std::vector<Record>& records, Key Record::*key, const char* what, const FileReader& file) {
  std::vector<Key> keys;
  keys.reserve(records.size());
  for (const Record& record : records) keys.push_back(record.*key);
  std::sort(keys.begin(), keys.end());
  const auto twice = std::adjacent_find(keys.begin(), keys.end());
  if (twice != keys.end()) input_error(file.name(), ": two ", what, " ", *twice, "; the file is damaged");
}

// Throws an InputError with the reason if no camera can have these values.
void check_camera(const ColmapCamera& camera, const std::string& file) {
  const std::string place = detail::concat(file, ": camera ", camera.id);
  if (camera.width < 1 || camera.height < 1 || camera.width > kMaxImageSide || camera.height > kMaxImageSide) {
    input_error(place, ": expected a width and height of 1 to ", kMaxImageSide, " px, found ", camera.width, " x ",
                camera.height, "; the file is damaged");
  }
  for (const double value : camera.params) {
    if (std::isfinite(value)) continue;
    input_error(place, " (", camera_model_name(camera.model), "): expected finite parameters ",
                camera_model_params(camera.model), ", found ", value, "; reconstruct the scene again");
  }
  camera_of(camera, place);
}

// Outputs are also named after images, so a name must not lead out of a folder.
bool points_outside(std::string name) {
  std::replace(name.begin(), name.end(), '\\', '/');
  const fs::path path(name);
  return path.is_absolute() || std::find(path.begin(), path.end(), "..") != path.end();
}

std::string place_of(const ColmapImage& image, const std::string& file) {
  return detail::concat(file, ": image ", image.id, " (", image.name, ")");
}

void check_pose(const ColmapImage& image, const std::string& file) {
  const std::string place = place_of(image, file);
  constexpr const char* kRemedy = "; remove the image from the model or reconstruct the scene again";
  double squared_length = 0;
  for (const double value : image.quat) squared_length += value * value;
  if (!(squared_length > 1e-12 && squared_length < 1e12)) {
    input_error(place, ": expected a rotation quaternion of length 1, found length ", std::sqrt(squared_length),
                kRemedy);
  }
  for (const double value : image.translation) {
    if (std::abs(value) <= kMaxCoordinate) continue;
    input_error(place, ": expected a translation of at most ", kMaxCoordinate, ", found the component ", value,
                kRemedy);
  }
}

void check_name(const ColmapImage& image, const std::string& file) {
  const std::string place = place_of(image, file);
  if (image.name.empty()) input_error(place, ": expected the name of an image file, found an empty name");
  if (points_outside(image.name) || detail::has_control_characters(image.name)) {
    input_error(place, ": expected a path inside the image folder, without \"..\" and control characters; rename the ",
                "image in the model");
  }
}

// Describes the records that `check` rejects, by ID.
template <class Record, class Check>
std::map<std::uint32_t, std::string> faults_of(const std::vector<Record>& records, const FileReader& file,
                                               const Check& check) {
  std::map<std::uint32_t, std::string> faults;
  for (const Record& record : records) {
    try {
      check(record, file.name());
    } catch (const InputError& error) {
      faults[record.id] = error.what();
    }
  }
  return faults;
}

// Removes points without a usable position. Returns a warning, or "" if there are none.
std::string leave_out_points(std::vector<ColmapPoint>& points, const std::string& file) {
  const auto is_unusable = [](double value) { return !(std::abs(value) <= kMaxCoordinate); };
  const auto is_bad = [&](const ColmapPoint& point) {
    return std::any_of(point.position.begin(), point.position.end(), is_unusable);
  };
  const auto first = std::find_if(points.begin(), points.end(), is_bad);
  if (first == points.end()) return "";
  const double found = *std::find_if(first->position.begin(), first->position.end(), is_unusable);
  const std::string fault = detail::concat(file, ": point ", first->id, ": expected coordinates of at most ",
                                           kMaxCoordinate, ", found ", found);
  const std::size_t n = points.size();
  points.erase(std::remove_if(first, points.end(), is_bad), points.end());
  if (points.empty()) input_error(fault, "; reconstruct the scene again");
  return detail::concat(fault, "; ", n - points.size(), " of ", n, " points are left out");
}

}  // namespace

std::optional<ColmapFormat> colmap_format(const fs::path& folder) {
  const auto count = [&](ColmapFormat format) {
    int n = 0;
    for (const char* stem : {"cameras", "images", "points3D"}) {
      std::error_code error;
      n += fs::is_regular_file(file_of(folder, stem, format), error) ? 1 : 0;
    }
    return n;
  };
  const int binary = count(ColmapFormat::kBinary), text = count(ColmapFormat::kText);
  if (std::max(binary, text) < 2) return std::nullopt;  // a single file with such a name may be anything
  return binary >= text ? ColmapFormat::kBinary : ColmapFormat::kText;
}

ColmapModel read_colmap_model(const ColmapFiles& files, ColmapFormat format, Observations observations) {
  ColmapModel model;
  const std::vector<ColmapCamera> cameras = read_records<ColmapCamera>(files.cameras, format);
  expect_different(cameras, &ColmapCamera::id, "cameras have the ID", files.cameras);
  const auto camera_faults = faults_of(cameras, files.cameras, check_camera);
  for (const ColmapCamera& camera : cameras) {
    if (camera_faults.count(camera.id) == 0) model.cameras.emplace(camera.id, camera);
  }
  const std::vector<ColmapImage> images = read_records<ColmapImage>(files.images, format, observations);
  for (const ColmapImage& image : images) check_name(image, files.images.name());
  expect_different(images, &ColmapImage::id, "images have the ID", files.images);
  expect_different(images, &ColmapImage::name, "images have the name", files.images);
  const auto pose_faults = faults_of(images, files.images, check_pose);
  for (const ColmapImage& image : images) {
    const auto pose_fault = pose_faults.find(image.id), camera_fault = camera_faults.find(image.camera_id);
    if (pose_fault != pose_faults.end()) {
      model.left_out.push_back({image.name, pose_fault->second});
    } else if (camera_fault != camera_faults.end()) {
      model.left_out.push_back({image.name, camera_fault->second});
    } else if (model.cameras.count(image.camera_id) == 0) {
      input_error(place_of(image, files.images.name()), ": camera ", image.camera_id,
                  " is not in the cameras file; the files belong to different models");
    } else {
      model.images.push_back(image);
    }
  }
  if (model.images.empty() && !model.left_out.empty()) input_error(model.left_out.front().reason);
  const bool has_foreign_tracks = files.point_format && observations == Observations::kAll;
  model.points = read_records<ColmapPoint>(files.points, files.point_format.value_or(format),
                                           has_foreign_tracks ? Observations::kNone : observations);
  model.left_out_points = leave_out_points(model.points, files.points.name());
  expect_different(model.points, &ColmapPoint::id, "points have the ID", files.points);
  return model;
}

ColmapModel read_colmap_model(const fs::path& folder, Observations observations, bool needs_points) {
  const std::optional<ColmapFormat> format = colmap_format(folder);
  if (!format) {
    input_error(folder.string(),
                ": no COLMAP model found (expected cameras, images and points3D, as .bin or .txt files)");
  }
  const ColmapFormat other_format = *format == ColmapFormat::kBinary ? ColmapFormat::kText : ColmapFormat::kBinary;
  const fs::path points_file = file_of(folder, "points3D", *format),
                 other_points_file = file_of(folder, "points3D", other_format);
  const bool has_points = fs::exists(points_file), has_other_points = !has_points && fs::exists(other_points_file);
  for (const char* stem : {"cameras", "images", "points3D"}) {
    const fs::path file = file_of(folder, stem, *format);
    const bool is_points = file == points_file;
    if (is_points ? has_points || has_other_points || !needs_points : fs::exists(file)) continue;
    input_error(file.string(), ": file not found; a COLMAP model has the files cameras, images and points3D, all ",
                file.extension().string(),
                is_points ? "; restore it, put a points3D.ply there, or pass points with --init_ply" : "");
  }
  FileReader cameras(file_of(folder, "cameras", *format)), images(file_of(folder, "images", *format));
  const std::string no_points(*format == ColmapFormat::kBinary ? sizeof(std::uint64_t) : 0, '\0');  // their number
  FileReader empty(points_file.string(), no_points);
  if (has_other_points) {
    FileReader points(other_points_file);
    return read_colmap_model({cameras, images, points, other_format}, *format, observations);
  }
  if (!has_points) return read_colmap_model({cameras, images, empty}, *format, observations);
  FileReader points(points_file);
  return read_colmap_model({cameras, images, points}, *format, observations);
}

std::uint64_t count_colmap_images(const fs::path& folder) {
  const ColmapFormat format = colmap_format(folder).value_or(ColmapFormat::kBinary);
  FileReader file(file_of(folder, "images", format));
  if (format == ColmapFormat::kText) return read_records<ColmapImage>(file, format).size();
  return BinaryReader{file, Observations::kNone}.n_elements(kKind<ColmapImage>.many, kKind<ColmapImage>.min_bytes);
}

std::array<double, 3> Similarity::operator()(const std::array<double, 3>& x) const {
  const std::array<double, 3> turned = rotated(rotation, x);
  return {scale * turned[0] + translation[0], scale * turned[1] + translation[1], scale * turned[2] + translation[2]};
}

std::array<double, 3> center_of(const ColmapImage& image) {
  return Camera{0, 0, 1, 1, 0, 0, {rotation_from_quaternion(image.quat), image.translation}}.center();
}

void transform(const Similarity& to_new, ColmapModel& model) {
  for (ColmapImage& image : model.images) {
    const std::array<double, 3> center = to_new(center_of(image));
    const std::array<double, 9> before = rotation_from_quaternion(image.quat);
    std::array<double, 9> rotation{};  // before * transpose(to_new.rotation)
    for (std::size_t row = 0; row < 3; ++row) {
      const std::array<double, 3> axis =
          rotated(to_new.rotation, {before[3 * row], before[3 * row + 1], before[3 * row + 2]});
      std::copy(axis.begin(), axis.end(), rotation.begin() + static_cast<std::ptrdiff_t>(3 * row));
    }
    image.quat = quaternion_from_rotation(rotation);
    const std::array<double, 3> moved = rotated(rotation, center);
    image.translation = {-moved[0], -moved[1], -moved[2]};
  }
  for (ColmapPoint& point : model.points) point.position = to_new(point.position);
}

void write_colmap_model(const fs::path& folder, const ColmapModel& model, ColmapFormat format) {
  std::vector<ColmapCamera> cameras;
  for (const auto& [id, camera] : model.cameras) {
    B3DGS_CHECK(camera.params.size() == static_cast<std::size_t>(camera_model_param_count(camera.model)), "camera ", id,
                " has ", camera.params.size(), " parameters");
    cameras.push_back(camera);
  }
  write_file(file_of(folder, "cameras", format), content_of(cameras, format));
  write_file(file_of(folder, "images", format), content_of(model.images, format));
  write_file(file_of(folder, "points3D", format), content_of(model.points, format));
}

}  // namespace b3dgs
