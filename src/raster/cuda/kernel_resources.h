// Resources of a kernel, which limit how many of its threads run at the same time. Plain C++: reports need no CUDA.
#pragma once

namespace b3dgs::cuda {

/// One kernel on the current device, for one tile shape.
struct KernelResources {
  int threads = 0;               // per block
  int registers = 0;             // per thread
  int shared_bytes = 0;          // static, per block
  int local_bytes = 0;           // per thread: stack and spilled registers
  int resident_threads = 0;      // per multiprocessor, by all limits
  int resident_threads_max = 0;  // per multiprocessor, of any kernel

  /// Theoretical occupancy, 0 to 1.
  double occupancy() const {
    return resident_threads_max > 0 ? static_cast<double>(resident_threads) / resident_threads_max : 0.0;
  }
};

}  // namespace b3dgs::cuda
