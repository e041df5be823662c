#include "compare/compare_results.h"

#include <algorithm>
#include <cmath>

#include "core/print.h"
#include "core/text.h"

namespace b3dgs {
namespace {

std::string number(double value, int digits) {
  return digits == 0 ? format_count(std::llround(value)) : print_to_string("%.*f", digits, value);
}

}  // namespace

std::vector<FinalResult> final_results(const std::vector<ConfigurationHistory>& configurations) {
  std::vector<FinalResult> results;
  const auto is_complete = [](const ConfigurationHistory& own, std::size_t seed) {
    return own.by_seed[seed].last_iteration() >= own.config.iterations && !own.by_seed[seed].points.empty();
  };
  const ConfigurationHistory& baseline = configurations.front();
  for (const ConfigurationHistory& configuration : configurations) {
    FinalResult result;
    result.name = configuration.name;
    result.iterations = configuration.config.iterations;
    std::vector<double> seconds, count, psnr, ssim, psnr_gained;
    for (std::size_t seed = 0; seed < configuration.by_seed.size(); ++seed) {
      if (!is_complete(configuration, seed)) continue;
      const LogPoint& last = configuration.by_seed[seed].points.back();
      ++result.n_complete;
      seconds.push_back(last.elapsed_s);
      if (last.count) count.push_back(static_cast<double>(*last.count));
      if (last.test_psnr) psnr.push_back(*last.test_psnr);
      if (last.test_ssim) ssim.push_back(*last.test_ssim);
      if (!is_complete(baseline, seed)) continue;
      const std::optional<double>& of_baseline = baseline.by_seed[seed].points.back().test_psnr;
      if (last.test_psnr && of_baseline) psnr_gained.push_back(*last.test_psnr - *of_baseline);
    }
    result.seconds = spread_of(seconds);
    result.count = spread_of(count);
    result.psnr = spread_of(psnr);
    result.ssim = spread_of(ssim);
    result.psnr_gained = effect_of(psnr_gained, kPsnrLimits);
    results.push_back(result);
  }
  return results;
}

bool have_equal_lengths(const std::vector<FinalResult>& results) {
  return std::all_of(results.begin(), results.end(),
                     [&](const FinalResult& own) { return own.iterations == results.front().iterations; });
}

std::string text_table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths(rows.front().size());
  for (const std::vector<std::string>& row : rows) {
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  std::string text;
  for (const std::vector<std::string>& row : rows) {
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string padding(widths[i] - row[i].size(), ' ');
      text += i == 0 ? row[i] + padding : "  " + padding + row[i];
    }
    text += "\n";
  }
  return text;
}

std::string results_table(const std::vector<FinalResult>& results) {
  std::vector<std::vector<std::string>> rows{
      {"at the end of", "iterations", "training s", "Gaussians", "PSNR dB", "SSIM"}};
  const auto mean = [](const std::optional<Spread>& spread, int digits) {
    return spread ? number(spread->mean, digits) : std::string("-");
  };
  for (const FinalResult& own : results) {
    rows.push_back({own.name, format_count(own.iterations), mean(own.seconds, 2), mean(own.count, 0), mean(own.psnr, 2),
                    mean(own.ssim, 4)});
  }
  return text_table(rows);
}

std::string describe_results(const std::vector<FinalResult>& results) {
  std::string text;
  for (const FinalResult& own : results) {
    if (!own.seconds) continue;
    text += (text.empty() ? "" : "; ") + own.name + print_to_string(" %.1f s", own.seconds->mean);
    if (own.psnr) text += print_to_string(", %.2f dB", own.psnr->mean);
    if (own.count) text += ", " + format_count(std::llround(own.count->mean)) + " Gaussians";
  }
  return text;
}

}  // namespace b3dgs
