#include "train/images/image_uploader.h"

namespace b3dgs::cuda {

ImageUploader::ImageUploader(int n_slots, int n_staging, std::int64_t image_bytes)
    : image_bytes_(image_bytes), stream_(make_stream()) {
  const auto n_bytes = static_cast<std::size_t>(image_bytes);
  B3DGS_CUDA_CHECK(cudaGetDevice(&device_));
  for (int i = 0; i < n_slots; ++i) slots_.push_back({make_memory_on_device(n_bytes), make_event(), make_event()});
  for (int i = 0; i < n_staging; ++i) staging_.push_back({make_pinned_memory(n_bytes), make_event()});
}

std::vector<std::uint8_t*> ImageUploader::staging() const {
  std::vector<std::uint8_t*> buffers;
  for (const Staging& staging : staging_) buffers.push_back(staging.bytes.get());
  return buffers;
}

void ImageUploader::upload(int buffer, std::int64_t n_bytes, int slot) {
  B3DGS_CHECK(n_bytes <= image_bytes_, "image of ", n_bytes, " bytes, slot of ", image_bytes_);
  const Staging& from = staging_[static_cast<std::size_t>(buffer)];
  const Slot& to = slot_at(slot);
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_.get(), to.released.get(), 0));  // returns at once if never recorded
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(to.bytes.get(), from.bytes.get(), static_cast<std::size_t>(n_bytes),
                                   cudaMemcpyHostToDevice, stream_.get()));
  B3DGS_CUDA_CHECK(cudaEventRecord(to.uploaded.get(), stream_.get()));
  B3DGS_CUDA_CHECK(cudaEventRecord(from.uploaded.get(), stream_.get()));
}

void ImageUploader::wait_for_upload_of(int buffer) const {
  B3DGS_CUDA_CHECK(cudaSetDevice(device_));  // is per thread
  B3DGS_CUDA_CHECK(cudaEventSynchronize(staging_[static_cast<std::size_t>(buffer)].uploaded.get()));
}

const std::uint8_t* ImageUploader::acquire(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(reader, slot_at(slot).uploaded.get(), 0));
  return slot_at(slot).bytes.get();
}

void ImageUploader::release(int slot, cudaStream_t reader) {
  B3DGS_CUDA_CHECK(cudaEventRecord(slot_at(slot).released.get(), reader));
}

}  // namespace b3dgs::cuda
