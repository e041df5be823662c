// Steps that fail. If one does, the state is rolled back to the end of the step before. Gaussians that cannot be
// rendered are removed, and for lack of memory the step is taken again while some can be freed. step.h says why that is
// cheap.
#pragma once

#include <cstdint>
#include <vector>

#include "raster/checks.h"
#include "train/step.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {

class StepRecovery {
 public:
  /// Both must outlive this.
  StepRecovery(Training& training, Team& team) : training_(training), team_(team) {}

  /// Takes one step, and repeats it without Gaussians that cannot be rendered, or with more free memory. @throws what
  /// failed, with the state rolled back; LossError
  void take_step();
  /// Waits for the losses not yet read, adds them to the average, and moves the poses. @throws LossError
  void read_losses();
  /// Repeats `work` without the Gaussians that it cannot render.
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
  /// Warns if no Gaussian is visible in half of the training views, or in more than before.
  void warn_of_empty_views(int iteration);

 private:
  /// Keeps a copy of the statistics, if the next step adds to them before it can fail.
  void save_statistics();
  void roll_back();
  void remove_invalid_gaussians(const InvalidGaussianError& error);
  /// Views' sizes, from which memory is planned, and whether they are empty.
  void note_views(const StepOutcome& outcome);

  Training& training_;
  Team& team_;
  LastStep last_;
  std::vector<torch::Tensor> saved_statistics_;  // as they were before the step; empty = not saved
  std::int64_t n_removed_at_warning_ = 0;
};

}  // namespace b3dgs
