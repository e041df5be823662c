// Reads with libtiff what OpenCV does not: the size of a TIFF without decoding it, and images with an alpha channel.
// OpenCV multiplies colours by alpha for some of them, and drops the alpha channel of others.
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

struct TiffSize {
  ImageSize image;
  ImageSize part;  // a tile, or a strip of rows, which decoders allocate as a whole; may be larger than the image
};

/// Returns whether the bytes begin like a TIFF or BigTIFF.
bool is_tiff(const std::vector<std::uint8_t>& bytes);

/// Returns the size of the first image. Returns nothing for other files, damaged ones, and if the first directory or
/// the lists of its parts come later in the file.
std::optional<TiffSize> tiff_size(const std::vector<std::uint8_t>& bytes);

/// Decodes a TIFF of grey or RGB samples with alpha, of 8 or 16 bits, to BGRA of the same depth. Alpha is not
/// premultiplied, regardless of the file, and the image is not turned by its orientation tag. Returns nothing for other
/// files, and an empty image for damaged ones. Check tiff_size() first, because memory is allocated for it.
std::optional<cv::Mat> decode_tiff_with_alpha(const std::vector<std::uint8_t>& bytes);

}  // namespace b3dgs
