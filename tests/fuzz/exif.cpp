// EXIF orientation in JPEG, PNG, WebP and TIFF files, and JPEG files that are turned upright.
#include <cstdint>

#include "fuzz/fuzz_target.h"
#include "scene/images/image.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  constexpr std::int64_t kMostPixels = 1 << 16;  // larger ones take too long to encode
  const std::vector<std::uint8_t> file(bytes.begin(), bytes.end());
  const int orientation = exif_orientation(file);
  B3DGS_CHECK(orientation >= 1 && orientation <= 8, "orientation ", orientation);
  std::vector<std::uint8_t> cleared = file;
  clear_tiff_orientation(cleared);
  B3DGS_CHECK(cleared == file || exif_orientation(cleared) == 1, "a TIFF whose orientation was not cleared");
  const auto size = image_size_from_header(file);
  if (!size || std::int64_t{size->width} * size->height > kMostPixels) return;
  const auto turned = turned_upright(file);
  if (!turned) return;
  const auto turned_size = image_size_from_header(*turned);
  const ImageSize expected = orientation >= 5 ? ImageSize{size->height, size->width} : *size;
  B3DGS_CHECK(turned_size && *turned_size == expected, "expected ", expected.width, " x ", expected.height);
  B3DGS_CHECK(exif_orientation(*turned) == 1, "a turned file with orientation ", exif_orientation(*turned));
}
