// What limits how many threads of a kernel run at once. Plain C++: reports need no CUDA.
#pragma once

namespace b3dgs::cuda {

/// A kernel on the current device, for one tile shape.
struct KernelResources {
  int threads = 0;               // per block
  int registers = 0;             // per thread
  int shared_bytes = 0;          // static, per block
  int local_bytes = 0;           // per thread: stack and spilled registers
  int resident_threads = 0;      // of this kernel on a multiprocessor, by all limits
  int resident_threads_max = 0;  // of any kernel

  /// Theoretical occupancy, 0 to 1: what a launch with enough blocks could keep resident.
  double occupancy() const {
    return resident_threads_max > 0 ? static_cast<double>(resident_threads) / resident_threads_max : 0.0;
  }
};

}  // namespace b3dgs::cuda
