// Rounds of density control within the available memory.
#pragma once

#include <cstdint>

#include "train/density/row_edit.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {

class DensityControl {
 public:
  /// Both must outlive this.
  DensityControl(Training& training, Team& team) : training_(training), state_(training.state), team_(team) {}

  /// Does the density control that falls on the iterations of the last step and has not been done yet. If a round, or
  /// the views after it, would not fit into memory, the number of Gaussians is held and training continues with the
  /// existing ones.
  void run();

 private:
  /// Adds fewer or no Gaussians if memory is short.
  void run_round(int iteration);
  void plan_and_apply(int iteration, bool adds);
  /// Whether the hold can end now that there is memory for `capacity` Gaussians (0 = any number).
  bool can_grow_again(std::int64_t capacity) const;
  /// The model does not grow beyond `count` until there is memory for more. Logged at the start of a hold and when it
  /// drops by over 1 %.
  void hold_count(std::int64_t count);

  Training& training_;
  TrainState& state_;  // training_.state
  Team& team_;
  bool growth_has_failed_ = false;  // in this session, although memory had seemed sufficient
};

/// Allocates memory for an edit of this process' rows, if possible with spare capacity, so that most rounds reallocate
/// nothing. `limit`: of the rows; 0 = none.
void reserve_rows(Training& training, const RowEdit& edit, std::int64_t limit);
void apply_reserved(Training& training, const RowEdit& edit, int iteration);

}  // namespace b3dgs
