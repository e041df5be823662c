// Sizes in the headers of image files, and completeness of JPEG and PNG.
#include "scene/images/image.h"

#include "fuzz/fuzz_target.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  const std::vector<std::uint8_t> file(bytes.begin(), bytes.end());
  if (const auto size = image_size_from_header(file)) {
    B3DGS_CHECK(size->width > 0 && size->height > 0, "size ", size->width, " x ", size->height);
  }
  const std::string damage = image_damage(file);
  if (!damage.empty()) input_error("image: ", damage);
}
