// Error checks for CUDA calls. A failure throws the call, its location, and CUDA's error name and text.
#pragma once

#include <cuda_runtime_api.h>

#include "core/check.h"

namespace b3dgs {

/// A failed CUDA call or kernel.
class CudaError : public Error {
 public:
  using Error::Error;
};

namespace detail {

[[noreturn]] inline void fail_cuda(cudaError_t code, const char* expression, const char* file, int line) {
  cudaGetLastError();  // clears the error, so that the next check does not report it again
  if (code == cudaErrorMemoryAllocation) throw OutOfMemoryError(concat(expression, ": out of memory"));
  throw CudaError(
      concat(file, ":", line, ": ", expression, ": ", cudaGetErrorName(code), ": ", cudaGetErrorString(code)));
}

}  // namespace detail
}  // namespace b3dgs

#define B3DGS_CUDA_CHECK(call)                                                                        \
  do {                                                                                                \
    const cudaError_t b3dgs_code = (call);                                                            \
    if (b3dgs_code != cudaSuccess) ::b3dgs::detail::fail_cuda(b3dgs_code, #call, __FILE__, __LINE__); \
  } while (false)

/// Checks the last kernel launch for launch errors. Does not wait for the kernel.
#define B3DGS_CUDA_CHECK_LAUNCH() B3DGS_CUDA_CHECK(cudaGetLastError())
