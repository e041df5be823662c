#include "config/schedule.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string_view>
#include <type_traits>
#include <vector>

#include "config/train_options.h"
#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

/// Rounds to the nearest integer, but a positive number of iterations does not become 0. @throws InputError that names
/// the option if the product is too large
template <class Integer>
Integer scaled(std::string_view option, Integer steps, double factor) {
  constexpr Integer kMost = std::numeric_limits<Integer>::max();
  if (steps <= 0) return steps;
  const double product = std::round(static_cast<double>(steps) * factor);
  if (!(product < static_cast<double>(kMost) + 1)) {
    input_error("--", option, " ", steps, " is to be multiplied by ", factor, " (expected a product of at most ", kMost,
                "); choose a smaller --steps_scaler");
  }
  return std::max(Integer{1}, static_cast<Integer>(product));
}

/// Returns the number of iterations that use each photograph so often, without overflow for any number of photographs.
std::int64_t iterations_of(int uses, std::size_t n_photographs) {
  constexpr std::size_t kMost = std::numeric_limits<int>::max();
  return static_cast<std::int64_t>(std::min(n_photographs, kMost)) * uses;
}

/// Returns how often each photograph is used if --max_epochs is not given.
int uses_by_overlap(int max_epochs, const Photographs& photographs) {
  constexpr double kEnough = 50, kLeastIterations = 500;
  const double n = static_cast<double>(std::max<std::size_t>(1, photographs.n));
  const double share = std::max(photographs.overlap / kEnough, kLeastIterations / (n * std::max(1, max_epochs)));
  return scaled("max_epochs", max_epochs, std::min(1.0, share));
}

}  // namespace

void scale_steps(TrainConfig& config, double factor, const std::function<bool(const Option&)>& is_wanted) {
  if (factor == 1) return;
  const TrainConfig before = config;
  visit_fields(config, [&](const Option& option, auto& value, const auto&, const char*) {
    if (option.steps == Steps::kNone || !is_wanted(option)) return;
    using Value = std::decay_t<decltype(value)>;
    if constexpr (std::is_integral_v<Value> && !std::is_same_v<Value, bool>) {
      value = scaled(option.name, value, factor);
    } else if constexpr (std::is_same_v<Value, std::vector<int>>) {
      for (int& entry : value) entry = scaled(option.name, entry, factor);
    }
  });
  // Rounds that coincided before still do. If the interval of resets or removals were rounded separately, it would no
  // longer be a multiple, and its rounds would fall between those of growth.
  const bool were_scaled = config.densification_interval != before.densification_interval &&
                           config.opacity_reset_interval != before.opacity_reset_interval;
  if (were_scaled && before.opacity_reset_interval % before.densification_interval == 0) {
    const int n_rounds = before.opacity_reset_interval / before.densification_interval;
    config.opacity_reset_interval = static_cast<int>(std::min<std::int64_t>(
        std::int64_t{n_rounds} * config.densification_interval, std::numeric_limits<int>::max()));
  }
}

void scale_schedule(TrainConfig& config, double factor, const GivenOptions& given) {
  scale_steps(config, factor, [&](const Option& option) {
    return option.steps == Steps::kSchedule && !given.contains(std::string(option.name));
  });
}

double limit_epochs(TrainConfig& config, const Photographs& photographs, const GivenOptions& given) {
  const int max_epochs = config.max_epochs;
  const int uses = given.contains("max_epochs") ? max_epochs : uses_by_overlap(max_epochs, photographs);
  const std::int64_t most = iterations_of(uses, photographs.n);
  if (most == 0 || config.iterations <= most) return 1;
  const double factor = static_cast<double>(most) / config.iterations;
  scale_schedule(config, factor, given);
  config.iterations = static_cast<int>(most);
  config.max_epochs = max_epochs;  // the limit stays the same
  return factor;
}

std::string describe_epochs(const TrainConfig& config, const Photographs& photographs) {
  for (const int uses : {config.max_epochs, uses_by_overlap(config.max_epochs, photographs)}) {
    if (uses == 0 || config.iterations != iterations_of(uses, photographs.n)) continue;
    const bool has_known_overlap = photographs.overlap < static_cast<double>(photographs.n);
    const std::string reason =
        uses < config.max_epochs && has_known_overlap
            ? print_to_string("; about %.0f photographs show the same point", photographs.overlap)
            : "";
    return detail::concat("schedule    ", format_count(config.iterations), " iterations: each photograph ",
                          format_count(uses), uses == 1 ? " time" : " times", " (--max_epochs", reason, ")");
  }
  return "";
}

}  // namespace b3dgs
