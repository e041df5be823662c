// Writes checkpoints in one go.
#pragma once

#include "train/checkpoint/checkpoint.h"

namespace b3dgs {

inline void write_checkpoint_file(const std::filesystem::path& path, const CheckpointFile& content) {
  std::vector<TensorEntry> entries;
  for (const auto& [name, tensor] : content.tensors) {
    entries.push_back({name, tensor.scalar_type(), tensor.sizes().vec()});
  }
  CheckpointFileWriter file(path, content.header, entries);
  for (const auto& [name, tensor] : content.tensors) {
    const torch::Tensor host = tensor.to(torch::kCPU).contiguous();
    file.append(host.data_ptr(), host.nbytes());
  }
  file.finish();
  file.commit();
}

inline void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                             const Scene& scene) {
  write_checkpoint_file(path, {checkpoint_header(config, state, scene_fingerprint(scene)), checkpoint_tensors(state)});
}

}  // namespace b3dgs
