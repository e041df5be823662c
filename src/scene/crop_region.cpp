#include "scene/crop_region.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "core/text.h"

namespace b3dgs {
namespace {

constexpr const char* kExpected =
    ": expected a box \"x0,y0,z0,x1,y1,z1\" or a sphere \"x,y,z,radius\" with finite numbers";

/// `place` begins the messages.
CropRegion parse_numbers(std::string_view text, const std::string& place) {
  constexpr std::size_t kBoxNumbers = 6, kSphereNumbers = 4;
  std::vector<double> numbers;
  for (TextFields fields(text); !fields.empty() && numbers.size() <= kBoxNumbers;) {
    numbers.push_back(fields.number<double>("a coordinate", [&] { return place; }));
    if (!std::isfinite(numbers.back())) input_error(place, kExpected);
  }
  CropRegion region;
  if (numbers.size() == kSphereNumbers) {
    std::copy_n(numbers.begin(), 3, region.center.begin());
    region.radius = numbers[3];
    if (!(region.radius > 0)) input_error(place, kExpected, "; the radius is not above 0");
    return region;
  }
  if (numbers.size() != kBoxNumbers) input_error(place, kExpected);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    region.low[axis] = std::min(numbers[axis], numbers[axis + 3]);
    region.high[axis] = std::max(numbers[axis], numbers[axis + 3]);
    if (region.low[axis] == region.high[axis]) input_error(place, ": the box has no volume");
  }
  return region;
}

}  // namespace

bool CropRegion::contains(const std::array<double, 3>& position) const {
  double squared = 0;
  bool is_inside = true;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double value = position[axis];
    is_inside = is_inside && value >= low[axis] && value <= high[axis];
    squared += (value - center[axis]) * (value - center[axis]);
  }
  return radius > 0 ? squared <= radius * radius : is_inside;
}

CropRegion parse_crop(const std::string& text) {
  const std::string place = "--crop " + text;
  if (text.find_first_not_of("0123456789+-.eE, \t") == std::string::npos) return parse_numbers(text, place);
  if (!std::filesystem::exists(text)) input_error(place, kExpected, ", or a file with one; there is no such file");
  FileReader file(text);
  std::optional<CropRegion> region;
  for (std::string_view line; file.read_line(line);) {
    const std::string_view words = TextFields(line).rest();
    if (words.empty() || words[0] == '#') continue;
    if (region) input_error("--crop ", file.place(), ": expected one region in the file, found another one");
    region = parse_numbers(words, "--crop " + file.place());
  }
  if (!region) input_error(place, kExpected, " in this file, found none");
  return *region;
}

std::string crop_text(const CropRegion& region) {
  const auto& [a, b, c] = region.radius > 0 ? region.center : region.low;
  const auto& [d, e, f] = region.high;
  if (region.radius > 0) return print_to_string("%.12g,%.12g,%.12g,%.12g", a, b, c, region.radius);
  return print_to_string("%.12g,%.12g,%.12g,%.12g,%.12g,%.12g", a, b, c, d, e, f);
}

CropRegion in_frame(const CoordinateFrame& frame, CropRegion region) {
  for (std::array<double, 3>* position : {&region.low, &region.high, &region.center}) {
    *position = frame.from_world(position->data());
  }
  region.radius /= frame.unit;
  return region;
}

}  // namespace b3dgs
