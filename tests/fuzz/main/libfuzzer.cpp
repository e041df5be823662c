// Entry point for libFuzzer, which treats an exception as a crash and keeps the input.
#include <cstddef>
#include <cstdint>

#include "fuzz/fuzz_target.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  b3dgs::fuzz::accepts_input({reinterpret_cast<const char*>(data), size});
  return 0;
}
