// A cache of the undistorters of a scene. Each holds a map of eight bytes per pixel, so a scene with one camera per
// image would need more memory for maps than for images: the most recently used ones are kept, the others are built
// again.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "scene/cameras/undistort.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Threads may share it once all groups are added.
class UndistorterCache {
 public:
  /// Keeps at most max_bytes; maps in use that are no longer cached are not counted.
  explicit UndistorterCache(std::int64_t max_bytes) : max_bytes_(max_bytes) {}

  /// Adds a group, the images of one lens and size, and returns its number. Errors begin with `place`.
  int add_group(const Lens& lens, ImageSize size, const std::string& place);

  /// Most bytes that the cache can take for these groups.
  std::int64_t most_kept_bytes() const;

  /// From the cache, or built now. @throws InputError as the constructor of Undistorter
  std::shared_ptr<const Undistorter> get(int group);

 private:
  struct Group {
    Lens lens;
    ImageSize size;
    std::string place;
    std::mutex build_mutex;                  // one thread builds the map, the others wait for it
    std::shared_ptr<const Undistorter> map;  // null: not cached; guarded by mutex_, as is last_use
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
