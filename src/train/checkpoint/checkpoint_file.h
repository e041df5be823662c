// The container of a checkpoint: a JSON header and named tensors, each with a checksum.
//
//   8 bytes   "B3DGSCKP"
//   uint32    version of the layout
//   uint32    CRC-32 of the header
//   uint64    bytes of the header
//   header    JSON: what the caller gave, and under "tensors" name, dtype, shape, bytes and CRC-32 of each; spaces may
//             follow, since its length is settled before the checksums are known
//   tensors   one after the other, in the header's order, row-major; nothing follows
//
// Numbers are little-endian, as on every machine that this program is built for.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

#include "core/files/atomic_file.h"

namespace b3dgs {

struct CheckpointFile {
  nlohmann::ordered_json header = nlohmann::ordered_json::object();
  std::vector<std::pair<std::string, torch::Tensor>> tensors;  // float32, int32 or int64; on the CPU when read
};

/// A tensor as the header describes it.
struct TensorEntry {
  std::string name;
  torch::ScalarType type = torch::kFloat32;  // float32, int32 or int64
  std::vector<std::int64_t> shape;
};

/// Writes a file piece by piece, for tensors that are in host memory in pieces only. It appears whole at commit(), or
/// not at all.
class CheckpointFileWriter {
 public:
  /// @throws IoError
  CheckpointFileWriter(const std::filesystem::path& path, nlohmann::ordered_json header,
                       const std::vector<TensorEntry>& tensors);

  /// The next bytes of the tensors, which follow one after the other. @throws IoError
  void append(const void* data, std::uint64_t bytes);

  /// After the last byte, with the header's checksums in place: commit() is all that is left. @throws IoError
  void finish();

  /// @throws IoError
  void commit() { file_.commit(); }

 private:
  std::string header_text() const;

  nlohmann::ordered_json header_;
  std::size_t header_bytes_ = 0;
  std::size_t tensor_ = 0;  // that the next byte belongs to
  std::uint64_t left_ = 0;  // bytes of it
  AtomicFile file_;
};

/// The file appears whole or not at all. @throws IoError
void write_checkpoint_file(const std::filesystem::path& path, const CheckpointFile& content);

/// Reads everything and believes nothing before it is checked. @throws InputError with the reason
CheckpointFile read_checkpoint_file(const std::filesystem::path& path);

/// The header alone, with its "tensors"; sizes are checked, tensors are not read. @throws InputError with the reason
nlohmann::ordered_json read_checkpoint_header(const std::filesystem::path& path);

/// Reads the whole file and keeps nothing. @throws InputError with the reason if any byte is not as it was written
void verify_checkpoint_file(const std::filesystem::path& path);

}  // namespace b3dgs
