// The speed of a training, and how long the rest takes at that speed.
#pragma once

#include <optional>

namespace b3dgs {

/// A running average over the last hundred iterations or so. It knows no clock. Steps get longer while the number of
/// Gaussians or the size of the views grows, so until then the rest takes longer than estimated.
class Eta {
 public:
  explicit Eta(int iterations) : iterations_(iterations) {}

  /// The training has done `iteration` in `elapsed_s`. A repeated iteration has no effect.
  void add(int iteration, double elapsed_s);

  double iterations_per_second() const;  // 0 = not known yet
  std::optional<double> seconds_left() const;

 private:
  int iterations_;
  int first_ = -1, last_ = -1;  // iterations
  double last_s_ = 0;           // elapsed_s of last_
  double seconds_per_iteration_ = 0;
};

}  // namespace b3dgs
