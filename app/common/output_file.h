// Checks of the file that a command is going to write.
#pragma once

#include <filesystem>
#include <string>

namespace b3dgs {

/// @throws InputError if `output` is a folder, or if it exists and `overwrite` is false
void check_output_file(const std::string& output, bool overwrite);

/// @throws InputError if `output` is the same file as `input`, which the command reads
void refuse_to_replace(const std::filesystem::path& input, const std::string& output);

}  // namespace b3dgs
