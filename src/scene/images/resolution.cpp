#include "scene/images/resolution.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>

#include "core/check.h"

namespace b3dgs {
namespace {

int divide_halves_up(int side, int divisor) {
  return std::max(1, static_cast<int>((2 * std::int64_t{side} + divisor) / (2 * std::int64_t{divisor})));
}

int divide_halves_to_even(int side, int divisor) {
  const int quotient = side / divisor, twice_rest = 2 * (side % divisor);
  const bool is_up = twice_rest > divisor || (twice_rest == divisor && quotient % 2 == 1);
  return std::max(1, quotient + (is_up ? 1 : 0));
}

}  // namespace

ImageSize divided_size(ImageSize size, int divisor) {
  return {divide_halves_up(size.width, divisor), divide_halves_up(size.height, divisor)};
}

ImageSize training_size(ImageSize size, int resolution) {
  if (resolution == 1 || resolution == 2 || resolution == 4 || resolution == 8) {
    return {divide_halves_to_even(size.width, resolution), divide_halves_to_even(size.height, resolution)};
  }
  const int width = resolution == -1 ? kMaxDefaultWidth : resolution;
  if (width >= size.width) return size;
  const std::int64_t height = std::int64_t{size.height} * width / size.width;
  return {width, std::max(1, static_cast<int>(height))};
}

bool has_same_aspect(ImageSize other, ImageSize size) {
  const std::int64_t across = std::int64_t{other.width} * size.height, down = std::int64_t{other.height} * size.width;
  return std::abs(across - down) < std::max(size.width, size.height);
}

void check_resolution(int resolution) {
  const bool divides = resolution == 1 || resolution == 2 || resolution == 4 || resolution == 8;
  if (resolution == -1 || divides || resolution >= kMinWidth) return;
  const std::string expected = detail::concat("1, 2, 4 or 8 to divide the size, -1 for a width of at most ",
                                              kMaxDefaultWidth, " px, or a width of at least ", kMinWidth, " px");
  if (resolution < 1) input_error("-r ", resolution, ": expected ", expected);
  input_error("-r ", resolution, ": images would be ", resolution, " px wide; expected ", expected);
}

}  // namespace b3dgs
