// Checkpoints and PLYs, written beside the training.
//
// On a GPU the tensors are copied on the device, where there is room, and a thread brings the copy to the file in
// pieces: training goes on at once. Without room, and on a CPU, where a copy would be a second model in the same
// memory, the training thread writes the pieces from the tensors themselves into the system's page cache, and the
// thread only waits for the disk. In no case is there a second model in host memory.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "raster/torch/gaussian_tensors.h"
#include "train/checkpoint/checkpoint_file.h"

namespace b3dgs {

struct WrittenFile {
  enum class Kind { kCheckpoint, kPly };

  Kind kind = Kind::kCheckpoint;
  int iteration = 0;
  std::filesystem::path path;
  std::string error;  // why it could not be written; empty: it is there
};

class OutputWriter {
 public:
  explicit OutputWriter(torch::Device device);
  /// Waits until all is written.
  ~OutputWriter();
  OutputWriter(const OutputWriter&) = delete;
  OutputWriter& operator=(const OutputWriter&) = delete;

  /// Tensors may change as soon as these return. `may_copy`: on a GPU, a copy on the device is worth its memory. Files
  /// are written in the order of the calls.
  void write_checkpoint(const WrittenFile& file, nlohmann::ordered_json header,
                        const std::vector<std::pair<std::string, torch::Tensor>>& tensors, bool may_copy);
  void write_ply(const WrittenFile& file, const GaussianTensors& gaussians, bool may_copy);

  bool is_busy() const;
  void wait();

  /// What has been written, or could not be, since the last call. @throws what is no IoError
  std::vector<WrittenFile> take();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
