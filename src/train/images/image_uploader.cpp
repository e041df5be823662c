#include "train/images/image_uploader.h"

#include "core/cuda_check.h"

namespace b3dgs::cuda {
namespace {

void make_event(cudaEvent_t& event) {
  B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&event, cudaEventDisableTiming));
}

}  // namespace

std::int64_t free_device_bytes() {
  std::size_t free = 0, total = 0;
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  return static_cast<std::int64_t>(free);
}

ImageUploader::ImageUploader(int n_slots, int n_staging, std::int64_t image_bytes) : image_bytes_(image_bytes) {
  const auto n_bytes = static_cast<std::size_t>(image_bytes);
  try {
    B3DGS_CUDA_CHECK(cudaGetDevice(&device_));
    // Non-blocking: does not synchronise with the default stream, on which LibTorch computes.
    B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking));
    for (int i = 0; i < n_slots; ++i) {
      Slot& slot = slots_.emplace_back();
      B3DGS_CUDA_CHECK(cudaMalloc(reinterpret_cast<void**>(&slot.bytes), n_bytes));
      make_event(slot.uploaded);
      make_event(slot.released);
    }
    for (int i = 0; i < n_staging; ++i) {
      Staging& staging = staging_.emplace_back();
      B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&staging.bytes), n_bytes));
      make_event(staging.uploaded);
    }
  } catch (...) {
    free_all();
    throw;
  }
}

ImageUploader::~ImageUploader() {
  free_all();
}

void ImageUploader::free_all() noexcept {
  if (stream_ != nullptr) cudaStreamSynchronize(stream_);  // wait for uploads
  for (const Slot& slot : slots_) {
    if (slot.uploaded != nullptr) cudaEventDestroy(slot.uploaded);
    if (slot.released != nullptr) cudaEventDestroy(slot.released);
    cudaFree(slot.bytes);  // waits for kernels that read it
  }
  for (const Staging& staging : staging_) {
    if (staging.uploaded != nullptr) cudaEventDestroy(staging.uploaded);
    cudaFreeHost(staging.bytes);
  }
  if (stream_ != nullptr) cudaStreamDestroy(stream_);
}

std::vector<std::uint8_t*> ImageUploader::staging() const {
  std::vector<std::uint8_t*> buffers;
  for (const Staging& staging : staging_) buffers.push_back(staging.bytes);
  return buffers;
}

void ImageUploader::upload(int buffer, std::int64_t n_bytes, int slot) {
  B3DGS_CHECK(n_bytes <= image_bytes_, "image of ", n_bytes, " bytes, slot of ", image_bytes_);
  const Staging& from = staging_[static_cast<std::size_t>(buffer)];
  const Slot& to = slot_at(slot);
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_, to.released, 0));  // returns at once if never recorded
  B3DGS_CUDA_CHECK(
      cudaMemcpyAsync(to.bytes, from.bytes, static_cast<std::size_t>(n_bytes), cudaMemcpyHostToDevice, stream_));
  B3DGS_CUDA_CHECK(cudaEventRecord(to.uploaded, stream_));
  B3DGS_CUDA_CHECK(cudaEventRecord(from.uploaded, stream_));
}

void ImageUploader::wait_for_upload_of(int buffer) const {
  B3DGS_CUDA_CHECK(cudaSetDevice(device_));  // is per thread
  B3DGS_CUDA_CHECK(cudaEventSynchronize(staging_[static_cast<std::size_t>(buffer)].uploaded));
}

const std::uint8_t* ImageUploader::acquire(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(reader, slot_at(slot).uploaded, 0));
  return slot_at(slot).bytes;
}

void ImageUploader::release(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaEventRecord(slot_at(slot).released, reader));
}

}  // namespace b3dgs::cuda
