// Runs steps. A step that fails is repeated after a roll-back to the end of the previous one. Gaussians that cannot be
// rendered are removed. If memory is short, some is freed, as long as there is some to free. step.h explains why a
// roll-back is cheap.
#pragma once

#include <cstdint>
#include <vector>

#include "raster/checks.h"
#include "train/step.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {

class StepRunner {
 public:
  /// Both arguments must outlive this object.
  StepRunner(Training& training, Team& team) : training_(training), team_(team) {}

  /// Takes one step. Repeats it without Gaussians that cannot be rendered, or with more free memory. @throws the error
  /// of the step, with the state rolled back; LossError
  void run_step();
  /// Reads back the losses of the last step, updates the running average, and applies the pose updates. @throws
  /// LossError
  void read_losses();
  /// Calls work(), and repeats it without the Gaussians that it cannot render.
  template <class Work>
  auto without_invalid_gaussians(Work&& work) {
    for (;;) {
      try {
        return work();
      } catch (const InvalidGaussianError& error) {
        remove_invalid_gaussians(error);
      }
    }
  }
  /// Warns if no Gaussian is visible in half of the training views, or in more views than at the last warning.
  void warn_of_empty_views(int iteration);

 private:
  /// Copies the density statistics if the next step adds to them before its last point of failure.
  void save_statistics();
  void roll_back();
  void remove_invalid_gaussians(const InvalidGaussianError& error);
  /// Records the sizes of the views, from which memory is planned, and which of them are empty.
  void note_views(const StepOutcome& outcome);

  Training& training_;
  Team& team_;
  LastStep last_;
  std::vector<torch::Tensor> saved_statistics_;  // copies from before the step; empty: not saved
  std::int64_t n_removed_at_warning_ = 0;
};

}  // namespace b3dgs
