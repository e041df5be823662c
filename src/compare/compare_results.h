// What each configuration has reached at the end of its own training, however long that is: time, quality, size.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "compare/compare_effect.h"

namespace b3dgs {

struct FinalResult {
  std::string name;
  int iterations = 0;             // of the configuration
  int n_complete = 0;             // seeds that have been trained to the end; those below are over these
  std::optional<Spread> seconds;  // training time
  std::optional<Spread> count;    // Gaussians
  std::optional<Spread> psnr, ssim;
  std::optional<Effect> psnr_gained;  // compared with the first, over the seeds that both have trained to the end
};

std::vector<FinalResult> final_results(const std::vector<ConfigurationHistory>& configurations);

/// Whether all configurations train for the same number of iterations.
bool have_equal_lengths(const std::vector<FinalResult>& results);

/// Lines for standard output with aligned columns, the first to the left.
std::string text_table(const std::vector<std::vector<std::string>>& rows);

/// The same for results.
std::string results_table(const std::vector<FinalResult>& results);

/// "inria 38.2 s, 28.90 dB, 931,000 Gaussians; fast 4.9 s, ..."; what is not known is left out.
std::string describe_results(const std::vector<FinalResult>& results);

}  // namespace b3dgs
