// The container format of checkpoints: magic, version, header and the position of each tensor. Without torch, so that
// tools can read headers. train/checkpoint/checkpoint_file.h describes the format.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/files/file_reader.h"

namespace b3dgs {

inline constexpr std::array<char, 8> kCheckpointMagic{'B', '3', 'D', 'G', 'S', 'C', 'K', 'P'};
inline constexpr std::uint32_t kCheckpointVersion = 1;

/// Element types of tensors.
enum class CheckpointDtype { kFloat32, kInt32, kInt64 };
struct CheckpointDtypeRow {
  const char* name;
  std::uint64_t bytes;
};
inline constexpr std::array<CheckpointDtypeRow, 3> kCheckpointDtypes{{{"float32", 4}, {"int32", 4}, {"int64", 8}}};

/// The header's entry for one tensor. `shape`, `dtype` and `bytes` agree.
struct CheckpointSection {
  std::string name;
  CheckpointDtype dtype{};
  std::vector<std::int64_t> shape;
  std::uint64_t bytes = 0;
  std::uint32_t crc = 0;
};

struct CheckpointLayout {
  nlohmann::ordered_json header;  // with "tensors"
  std::vector<CheckpointSection> sections;
};

/// Continues a CRC-32 with `data`; starts at 0.
std::uint32_t add_crc(std::uint32_t crc, const void* data, std::uint64_t bytes);

/// Reads the file up to the first tensor. The rest of the file has exactly the length that the header states. @throws
/// InputError with the reason and the remedy
CheckpointLayout read_checkpoint_layout(FileReader& file);

/// @throws InputError unless `crc`, of the bytes that were read, is that of the section
void check_crc(const FileReader& file, const CheckpointSection& section, std::uint32_t crc);

/// Checks the tensors after read_checkpoint_layout(). @throws InputError if a checksum is wrong
void verify_sections(FileReader& file, const CheckpointLayout& layout);

/// Reads only the header, including "tensors". Sizes are checked, tensors are not read. @throws InputError
nlohmann::ordered_json read_checkpoint_header(const std::filesystem::path& path);

/// Reads the whole file and verifies all checksums. @throws InputError with the reason if it is damaged
void verify_checkpoint_file(const std::filesystem::path& path);

}  // namespace b3dgs
