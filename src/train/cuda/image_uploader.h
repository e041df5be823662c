// Photographs in pinned memory, and a stream that brings them to a few slots on the device while the GPU computes.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>
#include <initializer_list>
#include <vector>

namespace b3dgs::cuda {

/// Of the current device, now.
std::int64_t free_device_bytes();

class ImageUploader {
 public:
  /// Slots of slot_bytes each. Memory is the uploader's own, not an allocator's that would hand it on.
  ImageUploader(int n_slots, std::int64_t slot_bytes);
  ~ImageUploader();
  ImageUploader(const ImageUploader&) = delete;
  ImageUploader& operator=(const ImageUploader&) = delete;

  /// Copies the arrays, one behind the other, into pinned memory. Returns the image's number. @throws CudaError if the
  /// host has no memory left that can be pinned
  int add(std::initializer_list<const std::vector<std::uint8_t>*> arrays);

  /// Starts to bring an image to a slot, once all that used the slot is done. Does not wait.
  void upload(int image, int slot);

  /// The slot's bytes on the device, complete for work that is queued on `reader` from now on. Does not wait.
  const std::uint8_t* acquire(int slot, cudaStream_t reader);

  /// What is queued on `reader` by now is the last that reads the slot. Does not wait.
  void release(int slot, cudaStream_t reader);

 private:
  struct Image {
    std::uint8_t* bytes = nullptr;  // pinned
    std::size_t n_bytes = 0;
  };
  struct Slot {
    std::uint8_t* bytes = nullptr;  // on the device
    cudaEvent_t uploaded = nullptr, released = nullptr;
  };
  void free_all() noexcept;
  Slot& slot_at(int slot) { return slots_[static_cast<std::size_t>(slot)]; }

  std::int64_t slot_bytes_ = 0;
  cudaStream_t stream_ = nullptr;
  std::vector<Image> images_;
  std::vector<Slot> slots_;
};

}  // namespace b3dgs::cuda
