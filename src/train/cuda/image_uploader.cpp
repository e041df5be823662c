#include "train/cuda/image_uploader.h"

#include <cstring>

#include "raster/cuda/cuda_check.h"

namespace b3dgs::cuda {

std::int64_t free_device_bytes() {
  std::size_t free = 0, total = 0;
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  return static_cast<std::int64_t>(free);
}

ImageUploader::ImageUploader(int n_slots, std::int64_t slot_bytes) : slot_bytes_(slot_bytes) {
  try {
    // Not bound to the default stream's order: LibTorch computes there.
    B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking));
    for (int i = 0; i < n_slots; ++i) {
      Slot& slot = slots_.emplace_back();
      B3DGS_CUDA_CHECK(cudaMalloc(reinterpret_cast<void**>(&slot.bytes), static_cast<std::size_t>(slot_bytes)));
      B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&slot.uploaded, cudaEventDisableTiming));
      B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&slot.released, cudaEventDisableTiming));
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
  if (stream_ != nullptr) cudaStreamSynchronize(stream_);  // nothing is copied any more
  for (const Slot& slot : slots_) {
    if (slot.uploaded != nullptr) cudaEventDestroy(slot.uploaded);
    if (slot.released != nullptr) cudaEventDestroy(slot.released);
    cudaFree(slot.bytes);  // waits for kernels that read it
  }
  for (const Image& image : images_) cudaFreeHost(image.bytes);
  if (stream_ != nullptr) cudaStreamDestroy(stream_);
}

int ImageUploader::add(std::initializer_list<const std::vector<std::uint8_t>*> arrays) {
  std::size_t n_bytes = 0;
  for (const auto* array : arrays) n_bytes += array->size();
  B3DGS_CHECK(static_cast<std::int64_t>(n_bytes) <= slot_bytes_, "an image has ", n_bytes, " bytes, a slot ",
              slot_bytes_);
  Image& image = images_.emplace_back();
  image.n_bytes = n_bytes;
  B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&image.bytes), n_bytes));
  std::uint8_t* out = image.bytes;
  for (const auto* array : arrays) {
    std::memcpy(out, array->data(), array->size());
    out += array->size();
  }
  return static_cast<int>(images_.size()) - 1;
}

void ImageUploader::upload(int image, int slot) {
  const Image& from = images_[static_cast<std::size_t>(image)];
  const Slot& to = slot_at(slot);
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_, to.released, 0));  // nothing to wait for at first use
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(to.bytes, from.bytes, from.n_bytes, cudaMemcpyHostToDevice, stream_));
  B3DGS_CUDA_CHECK(cudaEventRecord(to.uploaded, stream_));
}

const std::uint8_t* ImageUploader::acquire(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(reader, slot_at(slot).uploaded, 0));
  return slot_at(slot).bytes;
}

void ImageUploader::release(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaEventRecord(slot_at(slot).released, reader));
}

}  // namespace b3dgs::cuda
