#include "train/output/device_snapshot.h"

#include <algorithm>

#include "core/cuda_check.h"

namespace b3dgs::cuda {
namespace {

constexpr std::size_t kAlignment = 256;  // bytes

std::size_t aligned(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace

std::unique_ptr<DeviceSnapshot> DeviceSnapshot::make(const std::vector<DeviceBytes>& arrays, cudaStream_t stream) {
  std::size_t wanted = 0, free = 0, total = 0;
  for (const DeviceBytes& array : arrays) wanted += aligned(array.bytes);
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  if (wanted == 0 || free / 2 < wanted) return nullptr;
  std::unique_ptr<DeviceSnapshot> snapshot(new DeviceSnapshot);
  if (cudaMalloc(&snapshot->memory_, wanted) != cudaSuccess) {
    cudaGetLastError();  // clears the code: too little memory is not an error here
    snapshot->memory_ = nullptr;
    return nullptr;
  }
  char* to = static_cast<char*>(snapshot->memory_);
  for (const DeviceBytes& array : arrays) {
    if (array.bytes > 0) {
      B3DGS_CUDA_CHECK(cudaMemcpyAsync(to, array.data, array.bytes, cudaMemcpyDeviceToDevice, stream));
    }
    snapshot->arrays_.push_back({to, array.bytes});
    to += aligned(array.bytes);
  }
  return snapshot;
}

DeviceSnapshot::~DeviceSnapshot() {
  if (memory_ != nullptr) cudaFree(memory_);
}

DeviceReader::DeviceReader() {
  try {
    // Non-blocking: does not synchronise with the default stream, on which LibTorch computes.
    B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking));
    B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&reached_, cudaEventDisableTiming));
    for (int i = 0; i < 2; ++i) {
      B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&copied_[i], cudaEventDisableTiming | cudaEventBlockingSync));
      B3DGS_CUDA_CHECK(cudaMallocHost(&pieces_[i], kPieceBytes));
    }
  } catch (...) {
    free_all();
    throw;
  }
}

DeviceReader::~DeviceReader() {
  free_all();
}

void DeviceReader::free_all() noexcept {
  if (stream_ != nullptr) cudaStreamSynchronize(stream_);
  for (int i = 0; i < 2; ++i) {
    if (copied_[i] != nullptr) cudaEventDestroy(copied_[i]);
    if (pieces_[i] != nullptr) cudaFreeHost(pieces_[i]);
  }
  if (reached_ != nullptr) cudaEventDestroy(reached_);
  if (stream_ != nullptr) cudaStreamDestroy(stream_);
}

void DeviceReader::follow(cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaEventRecord(reached_, stream));
  B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_, reached_, 0));
}

void DeviceReader::read(const void* device, std::size_t bytes,
                        const std::function<void(const void*, std::size_t)>& take) {
  const std::size_t n_pieces = (bytes + kPieceBytes - 1) / kPieceBytes;
  const auto size_of = [&](std::size_t piece) { return std::min(kPieceBytes, bytes - piece * kPieceBytes); };
  const auto copy = [&](std::size_t piece) {
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(pieces_[piece % 2], static_cast<const char*>(device) + piece * kPieceBytes,
                                     size_of(piece), cudaMemcpyDeviceToHost, stream_));
    B3DGS_CUDA_CHECK(cudaEventRecord(copied_[piece % 2], stream_));
  };
  if (n_pieces > 0) copy(0);
  for (std::size_t piece = 0; piece < n_pieces; ++piece) {
    if (piece + 1 < n_pieces) copy(piece + 1);
    B3DGS_CUDA_CHECK(cudaEventSynchronize(copied_[piece % 2]));
    take(pieces_[piece % 2], size_of(piece));
  }
}

}  // namespace b3dgs::cuda
