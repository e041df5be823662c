// Pinned host buffers for photographs, and a stream that uploads them to a few slots in GPU memory while the GPU
// computes.
#pragma once

#include <cstdint>
#include <vector>

#include "core/cuda_handles.h"

namespace b3dgs::cuda {

class ImageUploader {
 public:
  /// Slots on the device and pinned staging buffers on the host, each of `image_bytes`. They are allocated by CUDA
  /// directly, since LibTorch's allocator may reuse memory while a copy is running. @throws CudaError
  ImageUploader(int n_slots, int n_staging, std::int64_t image_bytes);

  /// The staging buffers, to be filled by the caller.
  std::vector<std::uint8_t*> staging() const;

  /// Uploads the first `n_bytes` of a staging buffer to a slot, after all work that uses the slot. Asynchronous.
  void upload(int buffer, std::int64_t n_bytes, int slot);

  /// Waits until the last upload from the staging buffer is done, so that it may be overwritten. Any thread may call
  /// this, but not during an upload() from the same buffer.
  void wait_for_upload_of(int buffer) const;

  /// The slot's device memory, complete for work queued on `reader` from now on. Asynchronous.
  const std::uint8_t* acquire(int slot, cudaStream_t reader);

  /// Work queued on `reader` so far is the last that reads the slot. Asynchronous.
  void release(int slot, cudaStream_t reader);

 private:
  struct Staging {
    PinnedMemory bytes;
    Event uploaded;
  };
  struct Slot {
    MemoryOnDevice bytes;
    Event uploaded, released;
  };
  Slot& slot_at(int slot) { return slots_[static_cast<std::size_t>(slot)]; }

  int device_ = 0;
  std::int64_t image_bytes_ = 0;
  std::vector<Staging> staging_;
  std::vector<Slot> slots_;
  Stream stream_;  // last: its uploads end first
};

}  // namespace b3dgs::cuda
