// Available host memory.
#pragma once

#include <cstdint>
#include <filesystem>

namespace b3dgs {

/// Returns the bytes that this process can still allocate without swapping: the memory available on the system, or less
/// if a control group (v1 or v2, including parent groups) limits the process. Memory that only caches files counts as
/// available. Returns the largest std::int64_t if unknown. `root` is the folder that contains proc/ and sys/.
std::int64_t available_host_memory(const std::filesystem::path& root = "/");

}  // namespace b3dgs
