// Writes checkpoints and PLYs in the background.
//
// On a GPU the tensors are copied within device memory if there is room, and a background thread writes the copy to the
// file in pieces, so that training continues at once. Without room, and on a CPU (where a copy would be a second model
// in the same memory), the training thread writes the pieces from the tensors themselves to the system's page cache,
// and the background thread only waits for the disk. There is never a second copy of the model in host memory.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "model/formats/splat_formats.h"
#include "raster/torch/rasterizer.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {

struct WrittenFile {
  enum class Kind { kCheckpoint, kPly };

  Kind kind = Kind::kCheckpoint;
  int iteration = 0;
  std::filesystem::path path;
  std::string error;  // why it could not be written; empty = written
};

class OutputWriter {
 public:
  explicit OutputWriter(torch::Device device);
  /// Waits until all files are written.
  ~OutputWriter();
  OutputWriter(const OutputWriter&) = delete;
  OutputWriter& operator=(const OutputWriter&) = delete;

  /// The tensors may change as soon as these return. `may_copy`: the tensors may be copied within GPU memory. Files are
  /// written in the order of the calls.
  void write_checkpoint(const WrittenFile& file, nlohmann::ordered_json header,
                        const std::vector<std::pair<std::string, torch::Tensor>>& tensors, bool may_copy);
  /// The same with tensors that are never whole in memory: read(take) passes the bytes of one, piece by piece. Each is
  /// read on the calling thread, in order, unless the file cannot be written.
  struct TensorPieces {
    TensorEntry entry;
    std::function<void(const std::function<void(const void*, std::size_t)>& take)> read;
  };
  void write_checkpoint(const WrittenFile& file, nlohmann::ordered_json header,
                        const std::vector<TensorPieces>& tensors);
  /// `frame` is that of the Gaussians.
  void write_ply(const WrittenFile& file, const GaussianTensors& gaussians, const CoordinateFrame& frame,
                 bool may_copy);

  bool is_busy() const;
  void wait();

  /// Files that have been written, or could not be, since the last call. Rethrows errors other than IoError.
  std::vector<WrittenFile> take();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
