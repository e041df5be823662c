// Reads TIFF images with an alpha channel. OpenCV multiplies colours by alpha for some of them, and drops the alpha
// channel of others.
#pragma once

#include <cstdint>
#include <functional>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

/// Decodes a TIFF of grey or RGB samples with alpha, of 8 or 16 bits, to BGRA of the same depth. Alpha is not
/// premultiplied, regardless of the file, and the image is not turned by its orientation tag. Returns nothing for other
/// files, and an empty image for damaged ones. `check` is called with the size before memory is allocated.
std::optional<cv::Mat> decode_tiff_with_alpha(const std::vector<std::uint8_t>& bytes,
                                              const std::function<void(ImageSize)>& check);

}  // namespace b3dgs
