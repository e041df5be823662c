// Pinned host buffers for photographs, and a stream that uploads them to a few slots in GPU memory while the GPU
// computes.
#pragma once

#include <cstdint>
#include <vector>

#include "core/cuda_handles.h"

namespace b3dgs::cuda {

class ImageUploader {
 public:
  /// Allocates slots on the device and pinned staging buffers on the host, each of `image_bytes`. CUDA allocates them
  /// directly, because LibTorch's allocator may reuse memory while a copy is running. @throws CudaError
  ImageUploader(int n_slots, int n_staging, std::int64_t image_bytes)
      : image_bytes_(static_cast<std::size_t>(image_bytes)), stream_(make_stream()) {
    B3DGS_CUDA_CHECK(cudaGetDevice(&device_));
    for (int i = 0; i < n_slots; ++i) {
      slots_.push_back({make_memory_on_device(image_bytes_), make_event(), make_event()});
    }
    for (int i = 0; i < n_staging; ++i) staging_.push_back({make_pinned_memory(image_bytes_), make_event()});
  }

  /// Returns the staging buffers, which the caller fills.
  std::vector<std::uint8_t*> staging() const {
    std::vector<std::uint8_t*> buffers;
    for (const Staging& staging : staging_) buffers.push_back(staging.bytes.get());
    return buffers;
  }

  /// Uploads the first `n_bytes` of a staging buffer to a slot, after all work that uses the slot. Asynchronous.
  void upload(int buffer, std::int64_t n_bytes, int slot) {
    const auto size = static_cast<std::size_t>(n_bytes);
    B3DGS_CHECK(size <= image_bytes_, "image of ", n_bytes, " bytes, slot of ", image_bytes_);
    const Staging& from = staging_[static_cast<std::size_t>(buffer)];
    const Slot& to = slot_at(slot);
    B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_.get(), to.released.get(), 0));  // returns at once if never recorded
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(to.bytes.get(), from.bytes.get(), size, cudaMemcpyHostToDevice, stream_.get()));
    B3DGS_CUDA_CHECK(cudaEventRecord(to.uploaded.get(), stream_.get()));
    B3DGS_CUDA_CHECK(cudaEventRecord(from.uploaded.get(), stream_.get()));
  }

  /// Waits until the last upload from the staging buffer is done, so that it may be overwritten. Any thread may call
  /// this, but not during an upload() from the same buffer.
  void wait_for_upload_of(int buffer) const {
    B3DGS_CUDA_CHECK(cudaSetDevice(device_));  // the current device is a setting per thread
    B3DGS_CUDA_CHECK(cudaEventSynchronize(staging_[static_cast<std::size_t>(buffer)].uploaded.get()));
  }

  /// Returns the slot's device memory, which is complete for work queued on `reader` from now on. Asynchronous.
  const std::uint8_t* acquire(int slot, cudaStream_t reader) {
    B3DGS_CUDA_CHECK(cudaStreamWaitEvent(reader, slot_at(slot).uploaded.get(), 0));
    return slot_at(slot).bytes.get();
  }

  /// Declares that no work queued on `reader` later reads the slot. Asynchronous.
  void release(int slot, cudaStream_t reader) {
    B3DGS_CUDA_CHECK(cudaEventRecord(slot_at(slot).released.get(), reader));
  }

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
  std::size_t image_bytes_ = 0;
  std::vector<Staging> staging_;
  std::vector<Slot> slots_;
  Stream stream_;  // declared last, so that its uploads end before the memory is freed
};

}  // namespace b3dgs::cuda
