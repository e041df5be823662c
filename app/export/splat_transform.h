// Formats of other programs, by the program splat-transform (npm package @playcanvas/splat-transform).
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/status/status_line.h"
#include "model/formats/splat_formats.h"

namespace b3dgs {

/// Whether splat-transform has to write this file: its extension has no splat_format(), or is .compressed.ply.
bool needs_splat_transform(const std::filesystem::path& file);

/// @throws InputError with the way to get it if the program is not installed
void require_splat_transform(const std::filesystem::path& file);

/// Writes `cloud` to `file` in the format of its extension. The file appears complete or not at all.
/// @throws InputError with the program's own message if it fails
void write_by_splat_transform(const std::filesystem::path& file, const SplatCloud& cloud, StatusLine& status);

/// Reads such a file back; a page (.html) by the SOG file inside. Nothing, and the reason in `why_not`, if that is not
/// possible.
std::optional<SplatCloud> read_by_splat_transform(const std::filesystem::path& file, std::string& why_not,
                                                  StatusLine& status);

}  // namespace b3dgs
