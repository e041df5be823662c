// Which photograph is in which of a few slots, in GPU or host memory. Only bookkeeping: it moves no bytes.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/check.h"

namespace b3dgs {

class UploadSlots {
 public:
  struct Upload {
    int slot;
    std::int32_t view;
  };

  explicit UploadSlots(int n_slots) : views_(static_cast<std::size_t>(n_slots), kEmpty) {}

  /// Slot of a view; -1 = none.
  int slot_of(std::int32_t view) const {
    const auto it = std::find(views_.begin(), views_.end(), view);
    return it == views_.end() ? -1 : static_cast<int>(it - views_.begin());
  }

  /// Assigns a slot to each of `wanted` (at most as many as there are slots). Wanted views that have a slot keep it.
  /// Returns the uploads that are needed, in the order of `wanted`.
  std::vector<Upload> assign(const std::vector<std::int32_t>& wanted) {
    B3DGS_CHECK(wanted.size() <= views_.size(), wanted.size(), " views for ", views_.size(), " slots");
    const auto is_wanted = [&](std::int32_t view) {
      return std::find(wanted.begin(), wanted.end(), view) != wanted.end();
    };
    std::vector<Upload> uploads;
    for (const std::int32_t view : wanted) {
      if (slot_of(view) >= 0) continue;
      const auto slot =
          std::find_if(views_.begin(), views_.end(), [&](std::int32_t other) { return !is_wanted(other); });
      *slot = view;
      uploads.push_back({static_cast<int>(slot - views_.begin()), view});
    }
    return uploads;
  }

 private:
  static constexpr std::int32_t kEmpty = -1;
  std::vector<std::int32_t> views_;  // by slot
};

}  // namespace b3dgs
