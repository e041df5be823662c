// The order of the training views, drawn without replacement from a shuffled stack that is refilled when empty.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/random.h"

namespace b3dgs {

/// The order so far. Both members are part of a checkpoint.
struct ViewOrder {
  std::uint32_t n_refills = 0;
  std::vector<std::int32_t> remaining;  // the next view is the last element

  /// Takes the next view, an index in [0, n_views).
  std::int32_t next(std::int64_t seed, std::int32_t n_views) {
    if (remaining.empty()) refill(seed, n_views);
    const std::int32_t view = remaining.back();
    remaining.pop_back();
    return view;
  }

  /// Returns the next n views that next() will return, without taking them.
  std::vector<std::int32_t> upcoming(std::int64_t seed, std::int32_t n_views, std::size_t n) const {
    std::vector<std::int32_t> views(remaining.rbegin(),
                                    remaining.rbegin() + static_cast<std::ptrdiff_t>(std::min(n, remaining.size())));
    ViewOrder after;
    after.n_refills = n_refills;
    while (views.size() < n) views.push_back(after.next(seed, n_views));
    return views;
  }

 private:
  void refill(std::int64_t seed, std::int32_t n_views) {
    remaining.resize(static_cast<std::size_t>(n_views));
    for (std::int32_t i = 0; i < n_views; ++i) remaining[static_cast<std::size_t>(i)] = i;
    const RandomKey key{seed, RandomStream::kViewOrder, n_refills++};
    for (std::size_t i = remaining.size(); i > 1; --i) {  // Fisher-Yates
      const std::uint64_t bits = random_bits(key, i)[0];
      std::swap(remaining[i - 1], remaining[static_cast<std::size_t>(bits * i >> 32)]);
    }
  }
};

}  // namespace b3dgs
