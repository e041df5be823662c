// Removing a folder with everything in it.
//
// Not std::filesystem::remove_all: LibTorch of the Python packages carries a C++ library of its own inside, and where
// it is loaded that function resolves to a broken copy and crashes.
#pragma once

#include <filesystem>

namespace b3dgs {

/// Removes a file, or a folder with all below it; links are removed, not followed. Nothing there is no error. False if
/// something could not be removed.
bool remove_tree(const std::filesystem::path& path);

}  // namespace b3dgs
