#include "core/host_memory.h"

#include <algorithm>
#include <fstream>
#include <limits>
#include <optional>
#include <string>

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kUnknown = std::numeric_limits<std::int64_t>::max();

/// Returns the number in a file, or in its line "KEY NUMBER" or "KEY NUMBER UNIT", or nullopt if there is none ("max").
std::optional<std::int64_t> read_number(const fs::path& file, const std::string& wanted = "") {
  std::ifstream in(file);
  std::string key, rest;
  for (std::int64_t value = 0; (wanted.empty() || in >> key) && in >> value; std::getline(in, rest)) {
    if (key == wanted) return value;
  }
  return std::nullopt;
}

struct ControlGroupFiles {
  const char *limit, *usage, *file_cache;  // file_cache is a line of memory.stat
};
constexpr ControlGroupFiles kVersion1{"memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"};
constexpr ControlGroupFiles kVersion2{"memory.max", "memory.current", "inactive_file"};

std::int64_t group_available(const fs::path& folder, const ControlGroupFiles& files) {
  const auto limit = read_number(folder / files.limit), usage = read_number(folder / files.usage);
  if (!limit || !usage) return kUnknown;
  const std::int64_t in_use = *usage - read_number(folder / "memory.stat", files.file_cache).value_or(0);
  return std::max<std::int64_t>(0, *limit - in_use);
}

/// Returns the minimum over a group and its parents. In a container, the path of the group may not exist below `mount`.
/// Then the mount itself is the container's group.
std::int64_t hierarchy_available(const fs::path& mount, const fs::path& group, const ControlGroupFiles& files) {
  std::int64_t least = group_available(mount, files);
  fs::path folder = mount;
  for (const fs::path& part : group.relative_path()) {
    folder /= part;
    least = std::min(least, group_available(folder, files));
  }
  return least;
}

}  // namespace

std::int64_t available_host_memory(const fs::path& root) {
  const auto kilobytes = read_number(root / "proc/meminfo", "MemAvailable:");
  std::int64_t available = kilobytes ? *kilobytes * 1024 : kUnknown;
  std::ifstream groups(root / "proc/self/cgroup");  // lines of "NUMBER:CONTROLLERS:PATH"; v2: no controllers
  for (std::string line; std::getline(groups, line);) {
    const std::size_t first = line.find(':'), second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const std::string controllers = "," + line.substr(first + 1, second - first - 1) + ",";
    const std::string group = line.substr(second + 1);
    if (controllers == ",,") {
      available = std::min(available, hierarchy_available(root / "sys/fs/cgroup", group, kVersion2));
    } else if (controllers.find(",memory,") != std::string::npos) {
      available = std::min(available, hierarchy_available(root / "sys/fs/cgroup/memory", group, kVersion1));
    }
  }
  return available;
}

}  // namespace b3dgs
