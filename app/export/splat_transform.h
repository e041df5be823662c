// Formats of other programs, written by splat-transform (npm package @playcanvas/splat-transform).
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/common/status_line.h"
#include "model/formats/splat_formats.h"

namespace b3dgs {

/// Returns whether splat-transform has to write this file, because its extension has no splat_format(), or is
/// .compressed.ply.
bool needs_splat_transform(const std::filesystem::path& file);

/// @throws InputError with installation instructions if the program is missing
void require_splat_transform(const std::filesystem::path& file);

/// Returns whether the file is a page with a viewer (.html).
bool is_page(const std::filesystem::path& file);

/// The title of a page, and the settings of its viewer (JSON, of the viewer's version 1).
struct PageOptions {
  std::string title, settings;
};

/// Writes `cloud` to `file` in the format of its extension. Only a page uses `page`. The write is atomic. @throws
/// InputError with the program's own message if it fails
void write_by_splat_transform(const std::filesystem::path& file, const SplatCloud& cloud, const PageOptions& page,
                              StatusLine& status);

/// Reads such a file back. A page (.html) is read from the SOG file inside. Returns nothing, with the reason in
/// `why_not`, if that is not possible.
std::optional<SplatCloud> read_by_splat_transform(const std::filesystem::path& file, std::string& why_not,
                                                  StatusLine& status);

}  // namespace b3dgs
