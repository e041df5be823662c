// The container of a checkpoint as it is on disk, without the library that its tensors end up in: magic, version,
// header and where each tensor lies. checkpoint_file.h describes the format.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/files/file_reader.h"

namespace b3dgs {

inline constexpr std::array<char, 8> kCheckpointMagic{'B', '3', 'D', 'G', 'S', 'C', 'K', 'P'};
inline constexpr std::uint32_t kCheckpointVersion = 1;

/// Number formats of tensors.
enum class CheckpointDtype { kFloat32, kInt32, kInt64 };
struct CheckpointDtypeRow {
  const char* name;
  std::uint64_t bytes;
};
inline constexpr std::array<CheckpointDtypeRow, 3> kCheckpointDtypes{{{"float32", 4}, {"int32", 4}, {"int64", 8}}};

/// What the header says of one tensor. Its shape and its size in bytes agree.
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

/// CRC-32 of what came before, and of `data` after it; 0 to begin with.
std::uint32_t add_crc(std::uint32_t crc, const void* data, std::uint64_t bytes);

/// Reads everything but the tensors and leaves the reader at the first of them; what follows has exactly the length
/// that the header says. @throws InputError with the reason and the remedy
CheckpointLayout read_checkpoint_layout(FileReader& file);

/// @throws InputError if `crc`, of the bytes that were read, is not the section's.
void check_crc(const FileReader& file, const CheckpointSection& section, std::uint32_t crc);

/// Reads the tensors after the layout and keeps nothing. @throws InputError if a checksum is wrong
void verify_sections(FileReader& file, const CheckpointLayout& layout);

}  // namespace b3dgs
