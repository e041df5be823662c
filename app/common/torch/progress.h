// The progress of a training, on the status line, and its speed.
#pragma once

#include <optional>
#include <string>

#include "app/common/status_line.h"
#include "core/text.h"
#include "train/trainer.h"

namespace b3dgs {

/// Estimates the speed as a running average over about the last hundred iterations. It has no clock of its own. Steps
/// get longer while the number of Gaussians or the size of the views grows, so until then the estimate is too short.
class Eta {
 public:
  explicit Eta(int iterations) : iterations_(iterations) {}

  /// Records that the training has done `iteration` after `elapsed_s`. A repeated iteration has no effect.
  void add(int iteration, double elapsed_s);

  double iterations_per_second() const;  // 0 = not known yet
  std::optional<double> seconds_left() const;

 private:
  int iterations_;
  int first_ = -1, last_ = -1;  // iterations
  double last_s_ = 0;           // elapsed_s of last_
  double seconds_per_iteration_ = 0;
};

/// Formats "  37%  740/2000  6.1 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians  densifying"
std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  std::optional<double> seconds_left);

/// Returns hooks that show loading, messages and warnings on the status line, the latter two after `label`.
TrainHooks hooks_for(StatusLine& status, const std::string& label = "");

/// Shows the progress of training. Use it as a callback for TrainHooks::on_progress.
class TrainProgressView {
 public:
  TrainProgressView(StatusLine& status, const TrainConfig& config);
  void operator()(const TrainProgress& progress);

 private:
  StatusLine& status_;
  Eta eta_;
  int last_line_ = 0;  // iteration
};

}  // namespace b3dgs
