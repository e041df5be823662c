// Writes checkpoints and PLYs in the background.
//
// If GPU memory suffices, the tensors are copied within it and a background thread writes the copy to the file in
// pieces, so that training continues at once. Otherwise, and on a CPU (where a copy would be a second model in the same
// memory), the training thread writes the pieces from the tensors themselves to the system's page cache, and the
// background thread only waits for the disk. There is never a second copy of the model in host memory.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "core/task_queue.h"
#include "model/formats/splat_formats.h"
#include "raster/torch/rasterizer.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace cuda {
class DeviceReader;
}

struct WrittenFile {
  enum class Kind { kCheckpoint, kPly };

  Kind kind = Kind::kCheckpoint;
  int iteration = 0;
  std::filesystem::path path;
  std::string error;  // why the file could not be written; empty: it was written
};

class OutputWriter {
 public:
  using Bytes = std::string_view;  // data of a tensor in the memory of its device

  explicit OutputWriter(torch::Device device) : device_(device) {}
  /// Waits until all files are written.
  ~OutputWriter() { wait(); }
  OutputWriter(const OutputWriter&) = delete;
  OutputWriter& operator=(const OutputWriter&) = delete;

  /// Write a file. The tensors may change as soon as the call returns. `may_copy` allows to copy them within GPU
  /// memory. Files are written in the order of the calls.
  void write_checkpoint(const WrittenFile& file, const nlohmann::ordered_json& header,
                        const std::vector<CheckpointTensor>& tensors, bool may_copy);
  /// `frame` is the frame of the Gaussians.
  void write_ply(const WrittenFile& file, const GaussianTensors& gaussians, const CoordinateFrame& frame,
                 bool may_copy);

  bool is_busy() const { return queue_ != nullptr && queue_->is_busy(); }
  void wait() {
    if (queue_ != nullptr) queue_->finish();
  }

  /// Returns the files that have been written, or could not be for any reason, since the last call.
  std::vector<WrittenFile> take();

 private:
  struct Content;
  /// Calls `work`, which completes the file, on the background thread.
  void add(WrittenFile file, std::function<void()> work);
  /// Fills the file from the tensors on this thread, or from a copy on the background thread, which commits it.
  void write(WrittenFile file, const std::function<Content()>& open, const std::vector<torch::Tensor>& tensors,
             bool may_copy);
  void write_from_device(const WrittenFile& file, const Content& content, const std::vector<Bytes>& arrays,
                         bool may_copy);

  const torch::Device device_;
  std::shared_ptr<cuda::DeviceReader> reader_;
  std::mutex mutex_;
  std::vector<WrittenFile> done_;     // guarded by mutex_
  std::unique_ptr<TaskQueue> queue_;  // created with its thread for the first file
};

}  // namespace b3dgs
