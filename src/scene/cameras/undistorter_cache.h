// Undistorters of the cameras of a scene. A map takes eight bytes a pixel: those used last are kept, and the others
// are made again, since scenes with a camera of its own for each image would need more memory for maps than for images.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "scene/cameras/distortion.h"
#include "scene/cameras/undistort.h"
#include "scene/images/image_io.h"

namespace b3dgs {

/// Threads may share it once all groups are added.
class UndistorterCache {
 public:
  /// What is kept stays below max_bytes; maps in use are not counted.
  explicit UndistorterCache(std::int64_t max_bytes) : max_bytes_(max_bytes) {}

  /// Images of one lens and size. Returns the group's number. `place` is for messages.
  int add_group(const Lens& lens, ImageSize size, const std::string& place);

  /// The most bytes that are kept of these groups.
  std::int64_t most_kept_bytes() const;

  /// @throws InputError, beginning with the group's place, if no pixel would be valid
  std::shared_ptr<const Undistorter> get(int group);

 private:
  struct Group {
    Lens lens;
    ImageSize size;
    std::string place;
    std::mutex making;                       // one thread makes the map, the others wait for it
    std::shared_ptr<const Undistorter> map;  // null: not kept; this and the next under mutex_
    std::uint64_t last_use = 0;
  };

  std::shared_ptr<const Undistorter> find(Group& group);
  void keep(Group& group, std::shared_ptr<const Undistorter> map);

  const std::int64_t max_bytes_;
  std::vector<std::unique_ptr<Group>> groups_;
  std::mutex mutex_;
  std::uint64_t n_uses_ = 0;
  std::int64_t kept_bytes_ = 0;
};

}  // namespace b3dgs
