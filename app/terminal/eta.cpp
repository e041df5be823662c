#include "app/terminal/eta.h"

#include <algorithm>

namespace b3dgs {

void Eta::add(int iteration, double elapsed_s) {
  constexpr int kWindow = 100;  // iterations, a round of density control
  if (first_ < 0) {
    first_ = iteration;
  } else if (iteration <= last_) {
    return;
  } else {
    const double n = iteration - last_, seconds = std::max(0.0, elapsed_s - last_s_);
    const double share = std::min(1.0, n / std::min(iteration - first_, kWindow));  // at first, the plain mean
    seconds_per_iteration_ += share * (seconds / n - seconds_per_iteration_);
  }
  last_ = iteration;
  last_s_ = elapsed_s;
}

double Eta::iterations_per_second() const {
  return seconds_per_iteration_ > 0 ? 1 / seconds_per_iteration_ : 0;
}

std::optional<double> Eta::seconds_left() const {
  if (last_ == first_) return std::nullopt;
  return std::max(0, iterations_ - last_) * seconds_per_iteration_;
}

}  // namespace b3dgs
