#include "scene/crop_region.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {

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
  const auto place = [&] { return "--crop " + text; };
  constexpr std::size_t kBoxNumbers = 6, kSphereNumbers = 4;
  const std::string expected =
      ": expected a box \"x0,y0,z0,x1,y1,z1\" or a sphere \"x,y,z,radius\" with finite numbers";
  std::vector<double> numbers;
  for (TextFields fields(text); !fields.empty() && numbers.size() <= kBoxNumbers;) {
    numbers.push_back(fields.number<double>("a coordinate", place));
    if (!std::isfinite(numbers.back())) input_error(place(), expected);
  }
  CropRegion region;
  if (numbers.size() == kSphereNumbers) {
    std::copy_n(numbers.begin(), 3, region.center.begin());
    region.radius = numbers[3];
    if (!(region.radius > 0)) input_error(place(), expected, "; the radius is not above 0");
    return region;
  }
  if (numbers.size() != kBoxNumbers) input_error(place(), expected);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    region.low[axis] = std::min(numbers[axis], numbers[axis + 3]);
    region.high[axis] = std::max(numbers[axis], numbers[axis + 3]);
    if (region.low[axis] == region.high[axis]) input_error(place(), ": the box has no volume");
  }
  return region;
}

}  // namespace b3dgs
