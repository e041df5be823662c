// COLMAP's output lines to numbers, for the status line.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>

namespace b3dgs {

struct ColmapStep {
  std::size_t done = 0;
  std::size_t total = 0;  // 0: not in the line
};

/// Steps that a line reports, as versions 3.8 to 3.13 print them: "Processed file [3/50]", "Matching block [1/4, 2/4]",
/// "Matching image [3/50]", "Registering image #7 (12)". A block that is named is about to be matched or has been: done
/// counts it in both cases.
std::optional<ColmapStep> colmap_step(std::string_view line);

/// The number in "Camera: #3 - OPENCV", with which feature_extractor says which camera a photograph has got.
std::optional<std::size_t> colmap_camera(std::string_view line);

}  // namespace b3dgs
