// COLMAP's text files: one line for each camera and point, two for each image, comments after '#'. The counts in the
// comments are ignored: some programs write wrong ones.
#include "core/check.h"
#include "core/text_fields.h"
#include "scene/colmap/colmap_format.h"

namespace b3dgs::colmap {
namespace {

// The next line that is neither empty nor a comment.
bool next_record(FileReader& file, std::string_view& line) {
  while (file.read_line(line)) {
    const std::size_t first = line.find_first_not_of(" \t");
    if (first != std::string_view::npos && line[first] != '#') return true;
  }
  return false;
}

// Fields of the current line; errors name file and line.
class Record {
 public:
  Record(const FileReader& file, std::string_view line) : file_(file), fields_(line) {}

  template <class T>
  T number(const char* what) {
    return fields_.number<T>(what, [this] { return file_.place(); });
  }
  TextFields& fields() { return fields_; }

 private:
  const FileReader& file_;
  TextFields fields_;
};

// An image's second line holds only numbers. Without this check, a file that lacks the second lines would silently lose
// every other image.
void check_points2d_line(const FileReader& file, std::string_view line, const ColmapImage& image) {
  const std::size_t last = line.find_last_not_of(" \t,\r");
  if (last == std::string_view::npos) return;
  const std::size_t separator = line.find_last_of(" \t,", last);
  const std::size_t begin = separator == std::string_view::npos ? 0 : separator + 1;
  const std::string_view word = line.substr(begin, last + 1 - begin);
  if (word.find_first_not_of("0123456789+-.eE") == std::string_view::npos || word == "nan" || word == "inf") return;
  input_error(file.place(), ": expected the 2D points of image ", image.id, " (numbers, or an empty line), found \"",
              word.substr(0, 40), "\"");
}

}  // namespace

std::map<std::uint32_t, ColmapCamera> read_cameras_text(FileReader& file) {
  std::map<std::uint32_t, ColmapCamera> cameras;
  for (std::string_view line; next_record(file, line);) {
    Record record(file, line);
    ColmapCamera camera;
    camera.id = record.number<std::uint32_t>("the camera's ID");
    camera.model = camera_model_from_name(std::string(record.fields().word()), file.place());
    camera.width = record.number<std::uint64_t>("the camera's width");
    camera.height = record.number<std::uint64_t>("the camera's height");
    camera.params.resize(camera_model_param_count(camera.model));
    const std::string expected =
        detail::concat("the ", camera.params.size(), " parameters ", camera_model_params(camera.model), " of ",
                       camera_model_name(camera.model));
    for (double& value : camera.params) value = record.number<double>(expected.c_str());
    if (!record.fields().empty()) {
      input_error(file.place(), ": expected only ", expected, ", found \"", record.fields().rest(), "\" after them");
    }
    add_camera(cameras, std::move(camera), file.place());
  }
  return cameras;
}

std::vector<ColmapImage> read_images_text(FileReader& file) {
  std::vector<ColmapImage> images;
  for (std::string_view line; next_record(file, line);) {
    Record record(file, line);
    ColmapImage image;
    image.id = record.number<std::uint32_t>("the image's ID");
    for (double& value : image.quat) value = record.number<double>("the quaternion qw, qx, qy, qz");
    for (double& value : image.translation) value = record.number<double>("the translation tx, ty, tz");
    image.camera_id = record.number<std::uint32_t>("the ID of the image's camera");
    image.name = record.fields().rest();
    if (image.name.empty()) input_error(file.place(), ": expected the image's name, found the end of the line");
    if (file.read_line(line)) check_points2d_line(file, line, image);
    images.push_back(std::move(image));
  }
  return images;
}

std::vector<ColmapPoint> read_points_text(FileReader& file, bool tracks) {
  std::vector<ColmapPoint> points;
  for (std::string_view line; next_record(file, line);) {
    Record record(file, line);
    ColmapPoint point;
    point.id = record.number<std::uint64_t>("the point's ID");
    for (double& value : point.position) value = record.number<double>("the position x, y, z");
    for (std::uint8_t& value : point.color) value = record.number<std::uint8_t>("the colour r, g, b from 0 to 255");
    point.error = record.number<double>("the reprojection error");
    while (tracks && !record.fields().empty()) {
      point.image_ids.push_back(record.number<std::uint32_t>("the ID of an image in the track"));
      record.number<std::uint32_t>("the index of a 2D point in the track");
    }
    points.push_back(std::move(point));
  }
  return points;
}

}  // namespace b3dgs::colmap
