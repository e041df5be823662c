#include "model/edit/select.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/check.h"
#include "core/text_fields.h"

namespace b3dgs {
namespace {

constexpr std::size_t kBoxNumbers = 6, kSphereNumbers = 4;

std::size_t sh_rest_floats(int degree) {
  return 3 * static_cast<std::size_t>(sh_coefficient_count(degree) - 1);
}

/// Moves row `from` of an array with `width` values a row to row `to`, which is not below it.
void move_row(std::vector<float>& values, std::size_t width, std::size_t from, std::size_t to) {
  std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(from * width), width,
              values.begin() + static_cast<std::ptrdiff_t>(to * width));
}

template <class Visit>
void visit_arrays(SplatCloud& cloud, Visit&& visit) {
  visit(cloud.means, std::size_t{3});
  visit(cloud.log_scales, std::size_t{3});
  visit(cloud.quats, std::size_t{4});
  visit(cloud.logit_opacities, std::size_t{1});
  visit(cloud.sh0, std::size_t{3});
  visit(cloud.shN, sh_rest_floats(cloud.sh_degree));
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
  const auto place = [&] { return "--crop " + text; };
  const std::string expected =
      ": expected a box \"x0,y0,z0,x1,y1,z1\" or a sphere \"x,y,z,radius\" with finite numbers";
  std::vector<double> numbers;
  for (TextFields fields(text); !fields.empty() && numbers.size() <= kBoxNumbers;) {
    numbers.push_back(fields.number<double>("a number", place));
    if (!std::isfinite(numbers.back())) input_error(place(), expected);
  }
  CropRegion region;
  if (numbers.size() == kSphereNumbers && numbers[3] > 0) {
    std::copy_n(numbers.begin(), 3, region.center.begin());
    region.radius = numbers[3];
    return region;
  }
  if (numbers.size() != kBoxNumbers) {
    input_error(place(), expected, numbers.size() == kSphereNumbers ? "; the radius is not above 0" : "");
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    region.low[axis] = std::min(numbers[axis], numbers[axis + 3]);
    region.high[axis] = std::max(numbers[axis], numbers[axis + 3]);
    if (region.low[axis] == region.high[axis]) input_error(place(), ": the box has no volume");
  }
  return region;
}

std::int64_t keep_if(const std::function<bool(std::size_t row)>& keeps, SplatCloud& cloud) {
  const auto n = static_cast<std::size_t>(cloud.size());
  std::vector<std::size_t> rows;
  for (std::size_t row = 0; row < n; ++row) {
    if (keeps(row)) rows.push_back(row);
  }
  visit_arrays(cloud, [&](std::vector<float>& values, std::size_t width) {
    for (std::size_t to = 0; to < rows.size(); ++to) move_row(values, width, rows[to], to);
    values.resize(rows.size() * width);
  });
  return static_cast<std::int64_t>(n - rows.size());
}

std::int64_t keep_highest(const std::vector<double>& scores, std::int64_t count, SplatCloud& cloud) {
  const auto n = static_cast<std::size_t>(cloud.size());
  B3DGS_CHECK(scores.size() == n, scores.size(), " scores of ", n, " Gaussians");
  if (count >= cloud.size()) return 0;
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return scores[a] > scores[b]; });
  std::vector<bool> is_kept(n, false);
  for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) is_kept[order[i]] = true;
  return keep_if([&](std::size_t row) { return is_kept[row]; }, cloud);
}

double opacity_of(const SplatCloud& cloud, std::size_t row) {
  return 1 / (1 + std::exp(-static_cast<double>(cloud.logit_opacities[row])));
}

std::vector<double> opacity_times_area(const SplatCloud& cloud) {
  std::vector<double> result(static_cast<std::size_t>(cloud.size()));
  for (std::size_t row = 0; row < result.size(); ++row) {
    const float* const s = &cloud.log_scales[3 * row];
    const double without_shortest = static_cast<double>(s[0]) + s[1] + s[2] - std::min({s[0], s[1], s[2]});
    result[row] = opacity_of(cloud, row) * std::exp(without_shortest);
  }
  return result;
}

void limit_sh_degree(int degree, SplatCloud& cloud) {
  if (degree >= cloud.sh_degree) return;
  const std::size_t from = sh_rest_floats(cloud.sh_degree), to = sh_rest_floats(degree);
  for (std::size_t row = 0; row < static_cast<std::size_t>(cloud.size()); ++row) {
    std::copy_n(cloud.shN.begin() + static_cast<std::ptrdiff_t>(row * from), to,
                cloud.shN.begin() + static_cast<std::ptrdiff_t>(row * to));
  }
  cloud.shN.resize(static_cast<std::size_t>(cloud.size()) * to);
  cloud.sh_degree = degree;
}

}  // namespace b3dgs
