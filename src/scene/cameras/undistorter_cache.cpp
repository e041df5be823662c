#include "scene/cameras/undistorter_cache.h"

#include <algorithm>

namespace b3dgs {
namespace {

std::int64_t map_bytes(ImageSize size) {
  return std::int64_t{9} * size.width * size.height;  // two floats and the mask
}

}  // namespace

int UndistorterCache::add_group(const Lens& lens, ImageSize size, const std::string& place) {
  groups_.push_back(std::make_unique<Group>());
  groups_.back()->lens = lens;
  groups_.back()->size = size;
  groups_.back()->place = place;
  return static_cast<int>(groups_.size()) - 1;
}

std::int64_t UndistorterCache::most_kept_bytes() const {
  std::int64_t bytes = 0;
  for (const auto& group : groups_) bytes += map_bytes(group->size);
  return std::min(bytes, max_bytes_);
}

std::shared_ptr<const Undistorter> UndistorterCache::find(Group& group) {
  const std::lock_guard<std::mutex> lock(mutex_);
  group.last_use = ++n_uses_;
  return group.map;
}

void UndistorterCache::keep(Group& group, std::shared_ptr<const Undistorter> map) {
  const std::int64_t bytes = map_bytes(group.size);
  if (bytes > max_bytes_) return;
  const std::lock_guard<std::mutex> lock(mutex_);
  while (kept_bytes_ + bytes > max_bytes_) {
    Group* oldest = nullptr;
    for (const auto& other : groups_) {
      if (other->map && (oldest == nullptr || other->last_use < oldest->last_use)) oldest = other.get();
    }
    oldest->map.reset();
    kept_bytes_ -= map_bytes(oldest->size);
  }
  group.map = std::move(map);
  kept_bytes_ += bytes;
}

std::shared_ptr<const Undistorter> UndistorterCache::get(int group_number) {
  Group& group = *groups_.at(static_cast<std::size_t>(group_number));
  const std::lock_guard<std::mutex> building(group.build_mutex);
  if (auto map = find(group)) return map;
  auto map = std::make_shared<const Undistorter>(group.lens, group.size.width, group.size.height, group.place);
  keep(group, map);
  return map;
}

}  // namespace b3dgs
