// Rounds of density control within the available memory. If a round, or the views after it, would not fit, the number
// of Gaussians is held and training continues with the existing ones.
#pragma once

#include <cstdint>

#include "train/stepper.h"
#include "train/training.h"

namespace b3dgs {

class DensityControl {
 public:
  /// Both must outlive this.
  DensityControl(Training& training, Stepper& stepper) : training_(training), stepper_(stepper) {}

  /// What falls on the iterations of the last step and has not been done yet.
  void run();

 private:
  void run(int iteration);
  /// With fewer or no new Gaussians if memory is short.
  void run_round(int iteration);
  /// `adds`: whether Gaussians may be added.
  void plan_and_apply(int iteration, bool adds = true);
  /// Whether the hold can end now that there is memory for `room` Gaussians (0 = any number).
  bool can_grow_again(std::int64_t room) const;
  /// The model does not grow beyond `count` until there is memory for more. Logged at the start of a hold and when it
  /// drops by over 1 %.
  void hold_count(std::int64_t count);

  Training& training_;
  Stepper& stepper_;
  bool growth_has_failed_ = false;  // in this session, although memory had seemed sufficient
};

}  // namespace b3dgs
