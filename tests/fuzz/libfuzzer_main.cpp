// The entry that libFuzzer calls. An exception that leaves it is a crash to libFuzzer, which keeps the input.
#include <cstddef>
#include <cstdint>

#include "fuzz/fuzz_target.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  b3dgs::fuzz::takes_input({reinterpret_cast<const char*>(data), size});
  return 0;
}
