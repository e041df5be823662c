// Image files, decoded as photographs, alpha channels and depth maps. The decoders of other libraries are not
// instrumented, but the sizes that they find must be those that were checked before.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <iostream>

#include "core/descriptor.h"
#include "fuzz/fuzz_target.h"
#include "scene/images/image.h"

namespace b3dgs::fuzz {
namespace {

constexpr std::int64_t kMostPixels = 1 << 16;  // of larger images, only the header is read

/// OpenCV prints its errors.
struct QuietErrors {
  QuietErrors() { std::cerr.setstate(std::ios::failbit); }
  ~QuietErrors() { std::cerr.clear(); }
};

/// Returns the path of a file in memory with this content, which the next call replaces.
std::string store(std::string_view bytes) {
  static const Descriptor file(::memfd_create("image", MFD_CLOEXEC));
  B3DGS_CHECK(file && ::ftruncate(file.fd(), 0) == 0 &&
                  ::pwrite(file.fd(), bytes.data(), bytes.size(), 0) == static_cast<ssize_t>(bytes.size()),
              "the file in memory cannot be written");
  return "/proc/self/fd/" + std::to_string(file.fd());
}

}  // namespace

void read_input(std::string_view bytes) {
  const QuietErrors quiet;
  const std::string path = store(bytes);
  const ImageSize size = read_image_size(path);
  B3DGS_CHECK(size.width > 0 && size.height > 0, "size ", size.width, " x ", size.height);
  if (std::int64_t{size.width} * size.height > kMostPixels) return;
  try {
    const Depth16 map = read_depth_map(path);
    B3DGS_CHECK(map.size() == size, "a depth map of ", map.width, " x ", map.height);
  } catch (const InputError&) {  // most images are not depth maps
  }
  const Image8 image = read_image(path, /*white_background=*/false);
  B3DGS_CHECK(image.size() == size, "expected ", size.width, " x ", size.height, ", found ", image.width, " x ",
              image.height);
  if (const auto alpha = read_alpha(path)) B3DGS_CHECK(alpha->size() == size, "alpha of another size");
}

}  // namespace b3dgs::fuzz
