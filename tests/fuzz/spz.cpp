// SPZ files. Input that begins like the content of versions 1 to 3 is compressed first, because a fuzzer does not get
// past gzip's checksum.
#include "model/formats/splat_formats.h"

#include "fuzz/fuzz_target.h"
#include "fuzz/splat_check.h"
#include "support/formats/spz_content.h"

namespace b3dgs::fuzz {

void read_input(std::string_view bytes) {
  const bool is_content = bytes.substr(0, 4) == "NGSP" && bytes.substr(0, 5) != "NGSP\4";
  const std::string compressed = is_content ? test::gzip(bytes) : std::string();
  FileReader file("a.spz", is_content ? std::string_view(compressed) : bytes);
  check_splats(read_spz(file));
}

}  // namespace b3dgs::fuzz
