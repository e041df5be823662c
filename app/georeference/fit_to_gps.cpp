#include "app/georeference/fit_to_gps.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <opencv2/core.hpp>
#include <random>

#include "core/check.h"
#include "core/text.h"
#include "core/vec.h"

namespace b3dgs {
namespace {

using Points = std::vector<cv::Vec3d>;
using Weights = std::vector<double>;  // of each point

constexpr double kMostResidual = 0.1;     // of the spread of the cameras: beyond it, positions contradict the cameras
constexpr double kMostOfWidth = 0.05;     // of the spread across: beyond it, up may be wrong by 3 degrees
constexpr double kLeastWidth = 0.02;      // of the spread along: below it, the cameras stand in a line
constexpr double kLeastTolerance = 0.05;  // m, of positions that agree

cv::Vec3d mean_of(const Points& points, const Weights& weights) {
  cv::Vec3d sum;
  for (std::size_t i = 0; i < points.size(); ++i) sum += weights[i] * points[i];
  return sum * (1 / std::accumulate(weights.begin(), weights.end(), 0.0));
}

Similarity similarity(double scale, const cv::Matx33d& rotation, const cv::Vec3d& from, const cv::Vec3d& to) {
  Similarity result;
  result.scale = scale;
  std::copy_n(rotation.val, 9, result.rotation.begin());
  const cv::Vec3d translation = to - scale * (rotation * from);
  std::copy_n(translation.val, 3, result.translation.begin());
  return result;
}

/// Returns the similarity of least weighted squares (Horn, "Closed-form solution of absolute orientation using unit
/// quaternions", 1987).
Similarity fit_freely(const Points& from, const Points& to, const Weights& weights) {
  const cv::Vec3d a = mean_of(from, weights), b = mean_of(to, weights);
  cv::Matx33d m;  // sum of products
  for (std::size_t i = 0; i < from.size(); ++i) m += weights[i] * ((from[i] - a) * (to[i] - b).t());
  const cv::Matx44d n(m(0, 0) + m(1, 1) + m(2, 2), m(1, 2) - m(2, 1), m(2, 0) - m(0, 2), m(0, 1) - m(1, 0),  //
                      m(1, 2) - m(2, 1), m(0, 0) - m(1, 1) - m(2, 2), m(0, 1) + m(1, 0), m(2, 0) + m(0, 2),  //
                      m(2, 0) - m(0, 2), m(0, 1) + m(1, 0), m(1, 1) - m(0, 0) - m(2, 2), m(1, 2) + m(2, 1),  //
                      m(0, 1) - m(1, 0), m(2, 0) + m(0, 2), m(1, 2) + m(2, 1), m(2, 2) - m(0, 0) - m(1, 1));
  cv::Vec4d values;
  cv::Matx44d vectors;  // rows, in descending order of their values
  cv::eigen(n, values, vectors);
  const cv::Matx33d rotation(
      rotation_from_quaternion({vectors(0, 0), vectors(0, 1), vectors(0, 2), vectors(0, 3)}).data());
  double along = 0, squares = 0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    along += weights[i] * (to[i] - b).dot(rotation * (from[i] - a));
    squares += weights[i] * (from[i] - a).dot(from[i] - a);
  }
  return similarity(along / squares, rotation, a, b);
}

/// Returns a rotation that turns `up` into the z axis.
cv::Matx33d leveling(const cv::Vec3d& up) {
  const cv::Vec3d z = cv::normalize(up), other = std::abs(z[0]) < 0.5 ? cv::Vec3d(1, 0, 0) : cv::Vec3d(0, 1, 0);
  const cv::Vec3d x = cv::normalize(other - z.dot(other) * z), y = z.cross(x);
  return {x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]};
}

/// Does the same with a given up direction, by the horizontal coordinates alone.
Similarity fit_level(const Points& from, const Points& to, const Weights& weights, const cv::Matx33d& level) {
  const cv::Vec3d a = mean_of(from, weights), b = mean_of(to, weights);
  double cosine = 0, sine = 0, squares = 0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const cv::Vec3d p = level * (from[i] - a), q = to[i] - b;
    cosine += weights[i] * (p[0] * q[0] + p[1] * q[1]);
    sine += weights[i] * (p[0] * q[1] - p[1] * q[0]);
    squares += weights[i] * (p[0] * p[0] + p[1] * p[1]);
  }
  const double length = std::hypot(cosine, sine), c = cosine / length, s = sine / length;
  return similarity(length / squares, cv::Matx33d(c, -s, 0, s, c, 0, 0, 0, 1) * level, a, b);
}

class RobustFit {
 public:
  using Fit = std::function<Similarity(const Points&, const Points&, const Weights&)>;

  RobustFit(const GpsFitInput& input, Fit fit) : input_(input), fit_(std::move(fit)) {
    for (const auto& center : input.centers) from_.emplace_back(center.data());
    for (const auto& position : input.positions) to_.emplace_back(position.data());
  }

  /// `n_sample` positions determine a similarity.
  GpsFit run(std::size_t n_sample) const {
    constexpr int kTrials = 1000;  // with 45 % wrong positions, 0.55^3 = 17 % of the samples are right
    const std::size_t n = from_.size();
    std::mt19937 random(0);
    Similarity best = fit_(from_, to_, Weights(n, 1));
    double least = median(residuals(best));
    std::vector<std::size_t> order(n);
    std::iota(order.begin(), order.end(), std::size_t{0});
    for (int trial = 0; trial < kTrials; ++trial) {
      Weights sample(n, 0);
      for (std::size_t i = 0; i < n_sample; ++i) {
        std::swap(order[i], order[i + random() % (n - i)]);
        sample[order[i]] = 1;
      }
      const Similarity tried = fit_(from_, to_, sample);
      const double error = median(residuals(tried));
      if (error < least) {  // never with NaN, if all of the sample are in one place
        least = error;
        best = tried;
      }
    }
    // Rousseeuw and Leroy, "Robust Regression and Outlier Detection" (1987): the standard deviation by the median.
    const double spare = std::max(1.0, static_cast<double>(n) - static_cast<double>(n_sample));
    const double tolerance = std::max(kLeastTolerance, 2.5 * 1.4826 * (1 + 5 / spare) * least);
    constexpr int kRefinements = 50;
    for (int i = 0; i < kRefinements; ++i) {  // to the least sum of distances, because errors of GPS have long tails
      Weights weights = residuals(best);
      for (double& w : weights) w = w <= tolerance ? 1 / std::max(w, 0.1 * kLeastTolerance) : 0;
      best = fit_(from_, to_, weights);
    }
    GpsFit result;
    result.to_earth = best;
    const std::vector<double> distances = residuals(best);
    std::vector<double> kept;
    for (std::size_t i = 0; i < n; ++i) {
      if (!(distances[i] <= tolerance)) continue;
      result.kept.push_back(i);
      kept.push_back(distances[i]);
    }
    if (kept.empty()) return result;  // all cameras are in one place
    result.median_residual = median(kept);
    result.largest_residual = *std::max_element(kept.begin(), kept.end());
    return result;
  }

  /// Returns the standard deviations of the kept cameras along their principal axes, m, in descending order.
  cv::Vec3d spreads(const GpsFit& fit) const {
    Weights weights(from_.size(), 0);
    for (const std::size_t i : fit.kept) weights[i] = 1;
    const cv::Vec3d middle = mean_of(from_, weights);
    cv::Matx33d covariance;
    for (const std::size_t i : fit.kept) covariance += (from_[i] - middle) * (from_[i] - middle).t();
    cv::Vec3d values;
    cv::eigen(covariance, values);
    for (double& value : values.val) {
      value = fit.to_earth.scale * std::sqrt(std::max(0.0, value) / static_cast<double>(fit.kept.size()));
    }
    return values;
  }

 private:
  std::vector<double> residuals(const Similarity& fit) const {
    std::vector<double> distances;
    for (std::size_t i = 0; i < from_.size(); ++i) {
      const std::array<double, 3> at = fit({from_[i][0], from_[i][1], from_[i][2]});
      cv::Vec3d difference = cv::Vec3d(at.data()) - to_[i];
      if (!input_.has_heights) difference[2] = 0;
      distances.push_back(cv::norm(difference));
    }
    return distances;
  }

  const GpsFitInput& input_;
  Fit fit_;
  Points from_, to_;
};

}  // namespace

double median(std::vector<double> values) {
  const auto upper = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), upper, values.end());
  return values.size() % 2 == 1 ? *upper : (*upper + *std::max_element(values.begin(), upper)) / 2;
}

std::optional<GpsFit> fit_to_gps(const GpsFitInput& input, std::string& why_not) {
  B3DGS_CHECK(input.centers.size() == input.positions.size(), "a position for each camera");
  const std::size_t n = input.centers.size();
  if (n < kLeastPositions) {
    why_not = detail::concat("only ", n, n == 1 ? " photograph has" : " photographs have",
                             " a camera and a GPS position (expected at least ", kLeastPositions, ")");
    return std::nullopt;
  }
  const auto is_first = [&](const std::array<double, 3>& position) {
    return std::hypot(position[0] - input.positions[0][0], position[1] - input.positions[0][1]) < kLeastTolerance;
  };
  if (std::all_of(input.positions.begin(), input.positions.end(), is_first)) {
    why_not = "all GPS positions are the same";
    return std::nullopt;
  }
  constexpr std::size_t kFreeSample = 3, kLevelSample = 2;
  std::string undetermined = "the photographs have no height, so that they do not show which way is up";
  std::optional<GpsFit> fit;
  if (input.has_heights) {
    const RobustFit free(input, fit_freely);
    fit = free.run(kFreeSample);
    const cv::Vec3d spread = free.spreads(*fit);
    const double tilt_limit = kMostOfWidth * spread[1];
    if (!(fit->median_residual <= tilt_limit && spread[1] >= kLeastWidth * spread[0])) {
      undetermined = print_to_string(
          "the cameras stand in a line, or the GPS positions differ too much from them (%.1f m in the median, the "
          "cameras spread over %.1f x %.1f m), to determine which way is up",
          fit->median_residual, spread[0], spread[1]);
      fit.reset();
    }
  }
  if (!fit) {
    if (!input.up) {
      why_not = undetermined + ", and neither do the cameras show it";
      return std::nullopt;
    }
    const cv::Matx33d level = leveling(cv::Vec3d(input.up->data()));
    const RobustFit leveled(input, [&](const Points& from, const Points& to, const Weights& weights) {
      return fit_level(from, to, weights, level);
    });
    fit = leveled.run(kLevelSample);
    fit->is_level = true;
  }
  const double spread = RobustFit(input, fit_freely).spreads(*fit)[0];
  if (!(fit->median_residual <= kMostResidual * spread) || fit->kept.size() < std::max(kLeastPositions, (n + 1) / 2)) {
    why_not = print_to_string(
        "the GPS positions contradict the cameras: %zu of %zu agree, within %.1f m in the median, and the cameras "
        "spread "
        "over %.1f m",
        fit->kept.size(), n, fit->median_residual, spread);
    return std::nullopt;
  }
  return fit;
}

}  // namespace b3dgs
