// Estimates the remaining time of a training. The time per iteration grows with the number of Gaussians, which grows
// until densification ends.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

namespace b3dgs {

/// State of the training after `iteration`.
struct EtaSample {
  int iteration = 0;
  double elapsed_s = 0;  // training only, without evaluation and saving
  std::int64_t n_gaussians = 0;
  int view_scale = 1;  // the step's view had 1 / view_scale of its width and height
};

/// What is known about the rest of the training.
struct EtaPlan {
  int iterations = 0;
  int densify_from = 0, densify_until = 0;  // density control is active between these iterations
  std::int64_t max_gaussians = 0;           // 0: no limit
};

struct Eta {
  double seconds = 0;
  bool is_lower_bound = false;  // growth is unknown, since densification has not started, or views get larger
};

/// Models the time per iteration as a + b * count, fitted to the samples (ascending by iteration), and assumes that the
/// count keeps growing at the rate seen in the samples until `densify_until`. Empty with fewer than two samples.
std::optional<Eta> estimate_eta(const std::deque<EtaSample>& samples, const EtaPlan& plan);

/// Keeps recent samples at a spacing that depends on the length of the training, all of views of one scale.
class EtaHistory {
 public:
  explicit EtaHistory(const EtaPlan& plan) : plan_(plan) {}
  void add(const EtaSample& sample);
  std::optional<Eta> estimate() const { return estimate_eta(samples_, plan_); }
  /// Mean over the last few samples; 0 with fewer than two.
  double iterations_per_second() const;

 private:
  EtaPlan plan_;
  std::deque<EtaSample> samples_;
};

}  // namespace b3dgs
