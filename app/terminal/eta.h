// How long a training run will still take, given that the number of Gaussians, and with it the time of an iteration,
// grows until densification ends. Pure functions of numbers.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

namespace b3dgs {

/// State of a run after `iteration`.
struct EtaSample {
  int iteration = 0;
  double elapsed_s = 0;  // of training, without evaluation and saving
  std::int64_t n_gaussians = 0;
};

/// What is known of the rest of the run.
struct EtaPlan {
  int iterations = 0;
  int densify_from = 0, densify_until = 0;  // the count changes between these iterations
  std::int64_t max_gaussians = 0;           // 0: no limit
};

struct Eta {
  double seconds = 0;
  bool is_lower_bound = false;  // densification is still to come, and how fast the count will grow is not known
};

/// Time per iteration is modelled as a + b * count, fitted to the samples (ascending by iteration); the count goes on
/// growing at the rate of the samples up to `densify_until`. Nothing with fewer than two samples.
std::optional<Eta> estimate_eta(const std::deque<EtaSample>& samples, const EtaPlan& plan);

/// The recent samples of a run, at a spacing that suits its length.
class EtaHistory {
 public:
  explicit EtaHistory(const EtaPlan& plan) : plan_(plan) {}
  void add(const EtaSample& sample);
  std::optional<Eta> estimate() const { return estimate_eta(samples_, plan_); }
  /// Iterations per second over the last few samples, 0 with fewer than two.
  double iterations_per_second() const;

 private:
  EtaPlan plan_;
  std::deque<EtaSample> samples_;
};

}  // namespace b3dgs
