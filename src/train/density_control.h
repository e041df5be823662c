// Rounds of density control within the available memory.
#pragma once

#include <cstdint>

#include "train/density/row_edit.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {

class DensityControl {
 public:
  /// Both arguments must outlive this object.
  DensityControl(Training& training, Team& team) : training_(training), state_(training.state), team_(team) {}

  /// Runs the density control that is due after the last step and has not been done yet. If a round, or the views after
  /// it, would not fit into memory, the number of Gaussians is capped and training continues.
  void run();

 private:
  /// Plans and applies one round. If memory is short, it adds fewer Gaussians or none.
  void run_round(int iteration);
  void plan_and_apply(int iteration, bool adds);
  /// Returns whether the cap can be lifted, given memory for `capacity` Gaussians (0 = no limit).
  bool can_grow_again(std::int64_t capacity) const;
  /// Caps the number of Gaussians at `count` until there is memory for more. Logs the start of a cap, and a later cap
  /// only if it is over 1 % lower.
  void cap_count(std::int64_t count);

  Training& training_;
  TrainState& state_;  // training_.state
  Team& team_;
  bool growth_has_failed_ = false;  // in this session, although the forecast allowed it
};

/// Allocates memory for an edit of this process' Gaussians, if possible with spare capacity, so that most rounds
/// reallocate nothing. `limit` is the maximum number of Gaussians, 0 for no limit. @throws OutOfMemoryError
void reserve_rows(Training& training, const RowEdit& edit, std::int64_t limit);
/// Applies the edit of the last reserve_rows() and ends the round of density control of `iteration`.
void apply_reserved(Training& training, const RowEdit& edit, int iteration);

}  // namespace b3dgs
