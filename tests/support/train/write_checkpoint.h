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
  CheckpointFile content{checkpoint_header(config, state, scene_fingerprint(scene)), {}};
  for (const CheckpointTensor& tensor : checkpoint_tensors(state)) {
    content.tensors.emplace_back(tensor.entry.name, tensor.values);
  }
  write_checkpoint_file(path, content);
}

}  // namespace b3dgs
