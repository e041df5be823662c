#include "model/edit/edit.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include "core/check.h"
#include "core/parallel.h"
#include "core/text.h"
#include "core/vec.h"
#include "raster/math/sh.h"
#include "scene/cameras/camera.h"

namespace b3dgs {
namespace {

constexpr std::size_t kRest = 15;  // coefficients of degree 1 to 3

using Vec = Vec3<double>;

Mat3<double> to_matrix(const UnitQuat& rotation) {
  const std::array<double, 9> values = rotation_from_quaternion(rotation);
  Mat3<double> matrix{};
  for (int i = 0; i < 9; ++i) matrix.m[i] = values[static_cast<std::size_t>(i)];
  return matrix;
}

Vec normalized(const std::array<double, 3>& v) {
  const double length = std::hypot(v[0], v[1], v[2]);
  B3DGS_CHECK(length > 0, "a direction of length 0");
  return {v[0] / length, v[1] / length, v[2] / length};
}

/// a * b
UnitQuat product(const UnitQuat& a, const UnitQuat& b) {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

}  // namespace

UnitQuat rotation_between(const std::array<double, 3>& from, const std::array<double, 3>& to) {
  constexpr double kOpposite = 1e-12;
  const Vec a = normalized(from), b = normalized(to);
  Vec axis = cross(a, b);
  double w = 1 + dot(a, b);
  if (w < kOpposite) {  // half a turn about any perpendicular axis
    w = 0;
    axis = std::abs(a.x) < 0.5 ? cross(a, Vec{1, 0, 0}) : cross(a, Vec{0, 1, 0});
  }
  const double length = std::sqrt(w * w + dot(axis, axis));
  return {w / length, axis.x / length, axis.y / length, axis.z / length};
}

UnitQuat inverse(const UnitQuat& rotation) {
  return {rotation[0], -rotation[1], -rotation[2], -rotation[3]};
}

std::array<double, kRest * kRest> sh_rotation(const UnitQuat& rotation) {
  // Gauss-Legendre in z and equal angles around. This is exact for polynomials up to degree 7, and the products have 6.
  constexpr std::array<double, 4> kNodes{-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                         0.8611363115940526};
  constexpr std::array<double, 4> kWeights{0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                           0.3478548451374538};
  constexpr int kAngles = 8;
  constexpr int kDegree = 3;
  const Mat3<double> matrix = to_matrix(rotation);
  std::array<double, kRest * kRest> result{};
  for (std::size_t i = 0; i < kNodes.size(); ++i) {
    const double radius = std::sqrt(1 - kNodes[i] * kNodes[i]);
    for (int a = 0; a < kAngles; ++a) {
      const double angle = 2 * kPi * a / kAngles;
      const Vec direction{radius * std::cos(angle), radius * std::sin(angle), kNodes[i]};
      std::array<double, kRest + 1> at{}, before{};
      sh_basis(kDegree, direction, at.data());
      sh_basis(kDegree, transpose_times(matrix, direction), before.data());
      const double weight = kWeights[i] * 2 * kPi / kAngles;
      for (std::size_t j = 0; j < kRest; ++j) {
        for (std::size_t k = 0; k < kRest; ++k) result[kRest * j + k] += weight * at[j + 1] * before[k + 1];
      }
    }
  }
  return result;
}

void rotate_splats(const UnitQuat& rotation, SplatCloud& cloud) {
  const Mat3<double> matrix = to_matrix(rotation);
  const std::array<double, kRest* kRest> sh_matrix = sh_rotation(rotation);
  const std::size_t n_rest = sh_rest_count(cloud.sh_degree) / 3;
  const std::array<double, 3> from = cloud.frame.origin;
  const Vec origin = matrix * Vec{from[0], from[1], from[2]};
  cloud.frame.origin = {origin.x, origin.y, origin.z};
  constexpr std::int64_t kGrain = 4096;
  parallel_chunks(cloud.size(), kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (auto row = static_cast<std::size_t>(begin); row < static_cast<std::size_t>(end); ++row) {
      float* const mean = &cloud.means[3 * row];
      const Vec moved = matrix * Vec{mean[0], mean[1], mean[2]};
      mean[0] = static_cast<float>(moved.x);
      mean[1] = static_cast<float>(moved.y);
      mean[2] = static_cast<float>(moved.z);
      float* const quat = &cloud.quats[4 * row];
      const UnitQuat turned = product(rotation, {quat[0], quat[1], quat[2], quat[3]});
      for (std::size_t i = 0; i < 4; ++i) quat[i] = static_cast<float>(turned[i]);
      float* const sh = cloud.shN.data() + 3 * n_rest * row;
      std::array<double, 3 * kRest> rotated{};
      for (std::size_t j = 0; j < n_rest; ++j) {
        for (std::size_t k = 0; k < n_rest; ++k) {
          for (std::size_t c = 0; c < 3; ++c) rotated[3 * j + c] += sh_matrix[kRest * j + k] * sh[3 * k + c];
        }
      }
      for (std::size_t i = 0; i < 3 * n_rest; ++i) sh[i] = static_cast<float>(rotated[i]);
    }
  });
}

void scale_splats(double factor, SplatCloud& cloud) {
  for (double& value : cloud.frame.origin) value *= factor;
  cloud.frame.unit *= factor;
}

double parse_scale(const std::string& text) {
  constexpr std::size_t kNumbers = 7;
  const auto place = [&] { return "--scale " + text; };
  std::vector<double> numbers;
  for (TextFields fields(text); !fields.empty() && numbers.size() <= kNumbers;) {
    numbers.push_back(fields.number<double>("a number", place));
  }
  double factor = numbers.size() == 1 ? numbers[0] : 0;
  if (numbers.size() == kNumbers) {
    const double length = distance({numbers[0], numbers[1], numbers[2]}, {numbers[3], numbers[4], numbers[5]});
    factor = numbers[6] / length;
  }
  if (factor > 0 && std::isfinite(factor)) return factor;
  input_error(place(), ": expected a factor above 0, or two different points and the true distance between them, ",
              "\"x0,y0,z0,x1,y1,z1,distance\"; b3dgs view shows the coordinates of points that you click");
}

void move_to_utm(const Georeference& georeference, SplatCloud& cloud) {
  const CoordinateFrame before = cloud.frame;
  const std::vector<float> means = cloud.means;
  const double half = 0.5 * georeference.convergence * kDegree;
  rotate_splats({std::cos(half), 0, 0, std::sin(half)}, cloud);  // orientations and SH coefficients
  cloud.frame.origin = georeference.to_utm(before.origin);
  for (std::size_t i = 0; i < means.size(); i += 3) {
    const std::array<double, 3> world = georeference.to_utm(before.to_world(&means[i]));
    const std::array<double, 3> local = cloud.frame.from_world(world.data());
    for (std::size_t axis = 0; axis < 3; ++axis) cloud.means[i + axis] = static_cast<float>(local[axis]);
  }
}

std::int64_t keep_if(const std::function<bool(std::size_t row)>& keeps, SplatCloud& cloud) {
  const auto n = static_cast<std::size_t>(cloud.size());
  std::vector<std::size_t> rows;
  for (std::size_t row = 0; row < n; ++row) {
    if (keeps(row)) rows.push_back(row);
  }
  for (std::vector<float>* values :
       {&cloud.means, &cloud.log_scales, &cloud.quats, &cloud.logit_opacities, &cloud.sh0, &cloud.shN}) {
    const std::size_t width = n > 0 ? values->size() / n : 0;
    for (std::size_t to = 0; to < rows.size(); ++to) {
      std::copy_n(values->data() + rows[to] * width, width, values->data() + to * width);
    }
    values->resize(rows.size() * width);
  }
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
  const std::size_t from = sh_rest_count(cloud.sh_degree), to = sh_rest_count(degree);
  const auto n = static_cast<std::size_t>(cloud.size());
  for (std::size_t row = 0; row < n; ++row) {
    std::copy_n(cloud.shN.data() + row * from, to, cloud.shN.data() + row * to);
  }
  cloud.shN.resize(n * to);
  cloud.sh_degree = degree;
}

}  // namespace b3dgs
