// COLMAP's text files: cameras, images and points3D, in this order.
#include "fuzz/colmap_check.h"
#include "fuzz/fuzz_target.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  const std::vector<std::string_view> files = split_files(bytes, 3);
  read_colmap(files[0], files[1], files[2], ColmapFormat::kText);
}
