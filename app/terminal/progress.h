// The progress of a training, on the status line.
#pragma once

#include <optional>
#include <string>

#include "app/status/status_line.h"
#include "app/terminal/eta.h"
#include "core/text.h"
#include "train/trainer.h"

namespace b3dgs {

/// "  37%  740/2000  6.1 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians  densifying"
std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  std::optional<double> seconds_left);

/// Shows the progress of training; a callback for TrainHooks::on_progress.
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
