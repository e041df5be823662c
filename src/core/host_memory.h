// How much host memory there is to take.
#pragma once

#include <cstdint>
#include <filesystem>

namespace b3dgs {

/// Bytes that this process can still take without swapping: what the system has available, or less where a control
/// group (v1 or v2, its parents included) limits the process; memory that only caches files counts as available.
/// The largest std::int64_t if the system does not say. `root` is where /proc and /sys are looked for.
std::int64_t available_host_memory(const std::filesystem::path& root = "/");

}  // namespace b3dgs
