#include "report/svg/svg_axis.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/text.h"

namespace b3dgs {
namespace {

std::string with_decimals(double value, int decimals) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  return text;
}

int decimals_of_step(double step) {
  if (step <= 0) return 0;
  return std::clamp(static_cast<int>(std::ceil(-std::log10(step) - 1e-9)), 0, 9);
}

std::vector<double> linear_ticks(double low, double high, int n, double min_step) {
  const double rough = (high - low) / std::max(1, n);
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  double step = 10 * power;
  for (const double factor : {5.0, 2.0, 1.0}) {
    if (factor * power >= 0.7 * rough) step = factor * power;
  }
  step = std::max(step, min_step);
  std::vector<double> ticks;
  for (double i = std::ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; ++i) ticks.push_back(i * step);
  return ticks;
}

}  // namespace

double Scale::operator()(double value) const {
  const double share = kind == ScaleKind::kLog ? (std::log(value) - std::log(low)) / (std::log(high) - std::log(low))
                                               : (value - low) / (high - low);
  return from_px + share * (to_px - from_px);
}

std::vector<double> nice_ticks(ScaleKind kind, double low, double high, int n, double min_step) {
  if (!(high > low)) return {low};
  if (kind == ScaleKind::kLinear) return linear_ticks(low, high, n, min_step);
  const bool only_powers = std::log10(high / low) > 2;
  std::vector<double> ticks;
  for (double power = std::pow(10.0, std::floor(std::log10(low))); power <= high * 1.0001; power *= 10) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      const double tick = factor * power;
      if ((factor == 1.0 || !only_powers) && tick >= low * 0.9999 && tick <= high * 1.0001) ticks.push_back(tick);
    }
  }
  return ticks;
}

void pad_range(ScaleKind kind, bool from_zero, double& low, double& high) {
  if (kind == ScaleKind::kLog) {
    low = std::max(low, 1e-9);
    high = std::max(high, 2 * low);
    high *= 1.1;
    return;
  }
  if (from_zero) low = std::min(low, 0.0), high = std::max(high, 0.0);
  if (high <= low) high = low + std::max(1e-6, 0.1 * std::fabs(low));
  const double room = 0.05 * (high - low);
  if (!from_zero || high > 0) high += room;
  if (!from_zero || low < 0) low -= room;
}

std::string format_tick(double value, double step) {
  if (value == 0) return "0";
  if (std::fabs(value) >= 1e5 && step >= 1e5) {
    return with_decimals(value / 1e6, std::min(3, decimals_of_step(step / 1e6))) + " M";
  }
  if (std::fabs(value) >= 1000 && step >= 1) return format_count(std::llround(value));
  return with_decimals(value, decimals_of_step(step));
}

std::string format_seconds(double value, double smallest) {
  return with_decimals(value, smallest < 10 ? 2 : 1) + " s";
}

std::string format_figure(double value) {
  if (value == 0) return "0";
  if (std::fabs(value) >= 1e7) return with_decimals(value / 1e6, 1) + " M";
  if (std::fabs(value) >= 1000) return format_count(std::llround(value));
  if (value == std::round(value)) return with_decimals(value, 0);
  const int digits_before = static_cast<int>(std::floor(std::log10(std::fabs(value)))) + 1;
  return with_decimals(value, std::clamp(3 - digits_before, 0, 6));
}

}  // namespace b3dgs
