// The number of splats and (tile, splat) pairs per Gaussian in the views of a training, used to plan memory.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>

namespace b3dgs {

/// The largest numbers per Gaussian among the views rendered since the last but one round of density control. Older
/// views are not representative, because Gaussians get smaller as their number grows. Part of a checkpoint, because it
/// determines at which size memory stops the growth.
class ViewRatios {
 public:
  /// Values per Gaussian, 0 before the first view.
  struct Largest {
    double splats = 0, pairs = 0;
  };

  ViewRatios() = default;
  /// Restores the values of the views before the last round, and of those since.
  ViewRatios(const Largest& before, const Largest& now) : before_(before), now_(now) {}

  void add(std::int64_t n_splats, std::int64_t n_pairs, std::int64_t n_gaussians) {
    if (n_gaussians == 0) return;
    const double n = static_cast<double>(n_gaussians);
    now_.splats = std::max(now_.splats, static_cast<double>(n_splats) / n);
    now_.pairs = std::max(now_.pairs, static_cast<double>(n_pairs) / n);
  }
  /// Call at each round of density control.
  void begin_round() { before_ = std::exchange(now_, {}); }

  /// Returns the fraction of the Gaussians that a view sees, 1 before the first view.
  double splats() const { return ratio(&Largest::splats, 1); }
  /// Returns the (tile, splat) pairs per Gaussian, an estimate before the first view.
  double pairs() const { return ratio(&Largest::pairs, 4); }

  const Largest& before() const { return before_; }
  const Largest& now() const { return now_; }
  bool is_empty() const { return std::max({before_.splats, before_.pairs, now_.splats, now_.pairs}) == 0; }

 private:
  double ratio(double Largest::*which, double unknown) const {
    const double largest = std::max(before_.*which, now_.*which);
    return largest > 0 ? largest : unknown;
  }
  Largest before_, now_;
};

}  // namespace b3dgs
