// CUDA calls that fail say so: what was called, where, and CUDA's name and text for the fault.
#pragma once

#include <cuda_runtime_api.h>

#include "core/check.h"

namespace b3dgs {

/// A CUDA call or kernel failed.
class CudaError : public Error {
 public:
  using Error::Error;
};

namespace detail {

[[noreturn]] inline void fail_cuda(cudaError_t code, const char* expression, const char* file, int line) {
  cudaGetLastError();  // a fault that can be survived must not fail the next call as well
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

/// After every launch; asks for launch errors only and does not wait.
#define B3DGS_CUDA_CHECK_LAUNCH() B3DGS_CUDA_CHECK(cudaGetLastError())
