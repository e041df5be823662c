// The container of a checkpoint: a JSON header and named tensors, each with a checksum.
//
//   8 bytes   "B3DGSCKP"
//   uint32    version of the layout
//   uint32    CRC-32 of the header
//   uint64    bytes of the header
//   header    JSON: the caller's fields, and under "tensors" name, dtype, shape, bytes and CRC-32 of each; may be
//   padded
//             with spaces, since its length is fixed before the checksums are known
//   tensors   one after the other, in the header's order, row-major, up to the end of the file
//
// Numbers are little-endian.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

#include "core/files/atomic_file.h"
#include "model/checkpoint/checkpoint_layout.h"  // read_checkpoint_header(), verify_checkpoint_file()

namespace b3dgs {

struct CheckpointFile {
  nlohmann::ordered_json header = nlohmann::ordered_json::object();
  std::vector<std::pair<std::string, torch::Tensor>> tensors;  // float32, int32 or int64; on the CPU when read
};

/// The description of a tensor in the header.
struct TensorEntry {
  std::string name;
  torch::ScalarType type = torch::kFloat32;  // float32, int32 or int64
  std::vector<std::int64_t> shape;
};

/// Writes a checkpoint piece by piece, for tensors that are never whole in host memory. The file appears at commit(),
/// complete, or not at all.
class CheckpointFileWriter {
 public:
  /// @throws IoError
  CheckpointFileWriter(const std::filesystem::path& path, nlohmann::ordered_json header,
                       const std::vector<TensorEntry>& tensors);

  /// Appends the next bytes of the tensors. @throws IoError
  void append(const void* data, std::uint64_t bytes);

  /// Call after the last byte: writes the header with its checksums. Only commit() is left. @throws IoError
  void finish();

  /// @throws IoError
  void commit() { file_.commit(); }

 private:
  std::string header_text() const;

  nlohmann::ordered_json header_;
  std::size_t header_bytes_ = 0;
  std::size_t tensor_ = 0;  // index of the current tensor
  std::uint64_t left_ = 0;  // bytes missing of it
  AtomicFile file_;
};

/// Writes atomically: the file appears complete or not at all. @throws IoError
void write_checkpoint_file(const std::filesystem::path& path, const CheckpointFile& content);

/// Reads and checks the whole file. @throws InputError with the reason if it is damaged
CheckpointFile read_checkpoint_file(const std::filesystem::path& path);

}  // namespace b3dgs
