// Buffers in pinned memory for photographs, and a stream that brings them to a few slots on the device while the GPU
// computes.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>
#include <vector>

namespace b3dgs::cuda {

/// Of the current device, now.
std::int64_t free_device_bytes();

class ImageUploader {
 public:
  /// Slots on the device and staging buffers in host memory, each of `image_bytes`. Memory is the uploader's own, not
  /// an allocator's that would hand it on. @throws CudaError if there is not enough of it, or none that can be pinned
  ImageUploader(int n_slots, int n_staging, std::int64_t image_bytes);
  ~ImageUploader();
  ImageUploader(const ImageUploader&) = delete;
  ImageUploader& operator=(const ImageUploader&) = delete;

  /// The staging buffers, for the caller to fill.
  std::vector<std::uint8_t*> staging() const;

  /// Starts to bring the first `n_bytes` of a staging buffer to a slot, once all that used the slot is done. Does not
  /// wait.
  void upload(int buffer, std::int64_t n_bytes, int slot);

  /// Waits until the last upload from the staging buffer is done: it may be written then. Any thread may call this, if
  /// no upload() from the buffer happens at the same time.
  void wait_for_upload_of(int buffer) const;

  /// The slot's bytes on the device, complete for work that is queued on `reader` from now on. Does not wait.
  const std::uint8_t* acquire(int slot, cudaStream_t reader);

  /// What is queued on `reader` by now is the last that reads the slot. Does not wait.
  void release(int slot, cudaStream_t reader);

 private:
  struct Staging {
    std::uint8_t* bytes = nullptr;  // pinned
    cudaEvent_t uploaded = nullptr;
  };
  struct Slot {
    std::uint8_t* bytes = nullptr;  // on the device
    cudaEvent_t uploaded = nullptr, released = nullptr;
  };
  void free_all() noexcept;
  Slot& slot_at(int slot) { return slots_[static_cast<std::size_t>(slot)]; }

  int device_ = 0;
  std::int64_t image_bytes_ = 0;
  cudaStream_t stream_ = nullptr;
  std::vector<Staging> staging_;
  std::vector<Slot> slots_;
};

}  // namespace b3dgs::cuda
