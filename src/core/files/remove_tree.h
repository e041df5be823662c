// Removes a folder and its content.
//
// A replacement for std::filesystem::remove_all: LibTorch of the Python packages contains parts of a C++ standard
// library, and when it is loaded, remove_all resolves to a broken copy in it and crashes.
#pragma once

#include <filesystem>

namespace b3dgs {

/// Removes a file or a folder with its content. Symbolic links are removed, not followed. True if nothing is left,
/// including if there was nothing; else errno has the reason.
bool remove_tree(const std::filesystem::path& path);

}  // namespace b3dgs
