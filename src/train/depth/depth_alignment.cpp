#include "train/depth/depth_alignment.h"

#include <algorithm>
#include <cmath>

namespace b3dgs {
namespace {

/// The mean of the two in the middle for an even number.
double median(std::vector<double> values) {
  const std::size_t half = values.size() / 2;
  std::sort(values.begin(), values.end());
  return values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

double mean_absolute_deviation(const std::vector<double>& values, double from) {
  double sum = 0;
  for (const double value : values) sum += std::abs(value - from);
  return sum / static_cast<double>(values.size());
}

}  // namespace

std::optional<DepthAlignment> align_depth(const std::vector<double>& values,
                                          const std::vector<double>& inverse_depths) {
  if (values.size() < kMinAlignmentPoints) return std::nullopt;
  const double middle = median(values), middle_inverse = median(inverse_depths);
  const double spread = mean_absolute_deviation(values, middle),
               inverse_spread = mean_absolute_deviation(inverse_depths, middle_inverse);
  if (!(spread > 0) || !(inverse_spread > 0)) return std::nullopt;
  const double scale = inverse_spread / spread;
  return DepthAlignment{scale, middle_inverse - scale * middle};
}

int remove_unlikely_alignments(std::vector<std::optional<DepthAlignment>>& alignments) {
  std::vector<double> scales;
  for (const std::optional<DepthAlignment>& own : alignments) {
    if (own) scales.push_back(own->scale);
  }
  if (scales.empty()) return 0;
  const double middle = median(scales);
  int n_removed = 0;
  for (std::optional<DepthAlignment>& own : alignments) {
    if (!own || (own->scale >= kMinScaleRatio * middle && own->scale <= kMaxScaleRatio * middle)) continue;
    own.reset();
    ++n_removed;
  }
  return n_removed;
}

}  // namespace b3dgs
