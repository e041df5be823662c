#include "train/output/device_snapshot.h"

#include <algorithm>

namespace b3dgs::cuda {
namespace {

constexpr std::size_t kAlignment = 256;  // bytes

std::size_t aligned(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace

std::unique_ptr<DeviceSnapshot> DeviceSnapshot::make(const std::vector<std::string_view>& arrays, cudaStream_t stream) {
  std::size_t wanted = 0, free = 0, total = 0;
  for (const std::string_view array : arrays) wanted += aligned(array.size());
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  if (wanted == 0 || free / 2 < wanted) return nullptr;
  std::unique_ptr<DeviceSnapshot> snapshot(new DeviceSnapshot);
  try {
    snapshot->memory_ = make_memory_on_device(wanted);
  } catch (const OutOfMemoryError&) {  // others have taken it since
    return nullptr;
  }
  std::uint8_t* to = snapshot->memory_.get();
  for (const std::string_view array : arrays) {
    if (!array.empty()) {
      B3DGS_CUDA_CHECK(cudaMemcpyAsync(to, array.data(), array.size(), cudaMemcpyDeviceToDevice, stream));
    }
    snapshot->arrays_.emplace_back(reinterpret_cast<const char*>(to), array.size());
    to += aligned(array.size());
  }
  return snapshot;
}

DeviceReader::DeviceReader() : reached_(make_event()), stream_(make_stream()) {
  for (Piece& piece : pieces_) {
    piece = {make_pinned_memory(kPieceBytes), make_event(cudaEventDisableTiming | cudaEventBlockingSync)};
  }
}

void DeviceReader::follow(cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaEventRecord(reached_.get(), stream));
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_.get(), reached_.get(), 0));
}

void DeviceReader::read(const void* device, std::size_t bytes,
                        const std::function<void(const void*, std::size_t)>& take) {
  const std::size_t n_pieces = (bytes + kPieceBytes - 1) / kPieceBytes;
  const auto size_of = [&](std::size_t piece) { return std::min(kPieceBytes, bytes - piece * kPieceBytes); };
  const auto copy = [&](std::size_t piece) {
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(pieces_[piece % 2].bytes.get(),
                                     static_cast<const char*>(device) + piece * kPieceBytes, size_of(piece),
                                     cudaMemcpyDeviceToHost, stream_.get()));
    B3DGS_CUDA_CHECK(cudaEventRecord(pieces_[piece % 2].copied.get(), stream_.get()));
  };
  if (n_pieces > 0) copy(0);
  for (std::size_t piece = 0; piece < n_pieces; ++piece) {
    if (piece + 1 < n_pieces) copy(piece + 1);
    B3DGS_CUDA_CHECK(cudaEventSynchronize(pieces_[piece % 2].copied.get()));
    take(pieces_[piece % 2].bytes.get(), size_of(piece));
  }
}

}  // namespace b3dgs::cuda
