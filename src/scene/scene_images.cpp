#include "scene/scene_images.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>

#include "core/host_memory.h"
#include "scene/scene.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kMapShare = 8;  // undistortion maps get an eighth of the memory

// Photographs with the same distorted camera and file size share a group and a mask.
void assign_lens_groups(std::vector<ViewSource>& sources, UndistorterCache& cache) {
  using Key = std::tuple<std::uint32_t, int, int>;  // camera, width and height of the file
  struct Group {
    int number;
    std::shared_ptr<const Image8> valid;
  };
  std::map<Key, Group> groups;
  for (ViewSource& source : sources) {
    if (source.lens.is_pinhole()) continue;
    const Key key{source.camera_id, source.file_size.width, source.file_size.height};
    auto found = groups.find(key);
    if (found == groups.end()) {
      const int number = cache.add_group(source.lens, source.file_size, source.camera_place);
      std::shared_ptr<const Image8> valid = cache.get(number)->valid();
      if (valid) valid = std::make_shared<Image8>(shrink_mask(*valid, source.size.width, source.size.height));
      found = groups.emplace(key, Group{number, std::move(valid)}).first;
    }
    source.lens_group = found->second.number;
    source.valid = found->second.valid;
  }
}

}  // namespace

std::shared_ptr<SceneImages> prepare_images(std::vector<ViewSource>& sources, const SceneOptions& options) {
  ImageMemory::Plan plan;
  plan.limit = image_memory_limit(options.host_memory_gb, available_host_memory());
  plan.n_readers = options.n_readers;
  auto undistorters = std::make_unique<UndistorterCache>(plan.limit / kMapShare);
  assign_lens_groups(sources, *undistorters);
  plan.fixed = undistorters->most_kept_bytes();
  std::set<const Image8*> masks;
  for (const ViewSource& source : sources) {
    const std::int64_t bytes = std::int64_t{3} * source.size.width * source.size.height;
    plan.photographs += bytes;
    plan.largest = std::max(plan.largest, bytes);
    if (source.valid && masks.insert(source.valid.get()).second) {
      plan.fixed += static_cast<std::int64_t>(source.valid->pixels.size());
    }
  }
  return std::make_shared<SceneImages>(plan, std::move(undistorters), options.white_background);
}

}  // namespace b3dgs
