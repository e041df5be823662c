// Support for tests that need a GPU. Without one they are skipped, or fail if B3DGS_REQUIRE_GPU=1.
#pragma once

#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "core/cuda_check.h"

namespace b3dgs::test {

/// Returns the reason why no GPU can be used, or an empty text.
inline std::string gpu_fault() {
  int n_devices = 0;
  const cudaError_t code = cudaGetDeviceCount(&n_devices);
  if (code != cudaSuccess) return cudaGetErrorString(code);
  return n_devices > 0 ? "" : "no device";
}

inline bool gpu_is_required() {
  const char* value = std::getenv("B3DGS_REQUIRE_GPU");
  return value != nullptr && std::strcmp(value, "1") == 0;
}

/// Use as the first statement of SetUp() or of a test.
#define B3DGS_NEEDS_GPU()                                                                 \
  if (const std::string fault = ::b3dgs::test::gpu_fault(); !fault.empty()) {             \
    if (::b3dgs::test::gpu_is_required()) FAIL() << "B3DGS_REQUIRE_GPU=1, but " << fault; \
    GTEST_SKIP() << "no GPU: " << fault;                                                  \
  }

/// An array in device memory. It is initialised with 0xff bytes, which are NaN as float, so that missing writes are
/// detected.
template <class T>
class DeviceArray {
 public:
  explicit DeviceArray(std::int64_t n) : n_(n) {
    B3DGS_CUDA_CHECK(cudaMalloc(reinterpret_cast<void**>(&data_), bytes() + 1));
    B3DGS_CUDA_CHECK(cudaMemset(data_, 0xff, bytes()));
  }
  DeviceArray(const T* host, std::int64_t n) : DeviceArray(n) {
    B3DGS_CUDA_CHECK(cudaMemcpy(data_, host, bytes(), cudaMemcpyHostToDevice));
  }
  ~DeviceArray() { cudaFree(data_); }
  DeviceArray(DeviceArray&& other) noexcept : n_(other.n_), data_(other.data_) { other.data_ = nullptr; }
  DeviceArray& operator=(DeviceArray&&) = delete;

  T* data() const { return data_; }
  /// Synchronises with the device.
  void download(T* host) const { B3DGS_CUDA_CHECK(cudaMemcpy(host, data_, bytes(), cudaMemcpyDeviceToHost)); }

 private:
  std::size_t bytes() const { return static_cast<std::size_t>(n_) * sizeof(T); }
  std::int64_t n_ = 0;
  T* data_ = nullptr;
};

}  // namespace b3dgs::test
