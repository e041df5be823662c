// The container format of checkpoints: magic, version, header and the position of each tensor. Without torch, so that
// tools can read headers. train/checkpoint/checkpoint.h describes the format.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "config/view_order.h"
#include "config/view_ratios.h"
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

/// Continues a CRC-32 with `data`. It starts at 0.
std::uint32_t add_crc(std::uint32_t crc, const void* data, std::uint64_t bytes);

/// Reads the file up to the first tensor. The rest of the file has exactly the length given in the header. @throws
/// InputError with the reason and the remedy
CheckpointLayout read_checkpoint_layout(FileReader& file);

/// @throws InputError unless `crc`, computed from the bytes read, is that of the section
void check_crc(const FileReader& file, const CheckpointSection& section, std::uint32_t crc);

/// Checks the tensors after read_checkpoint_layout(). @throws InputError if a checksum is wrong
void verify_sections(FileReader& file, const CheckpointLayout& layout);

/// Reads only the header, including "tensors". Checks sizes, but does not read tensors. @throws InputError
nlohmann::ordered_json read_checkpoint_header(const std::filesystem::path& path);

/// Reads the whole file and verifies all checksums. @throws InputError with the reason if it is damaged
void verify_checkpoint_file(const std::filesystem::path& path);

// The header of a checkpoint: everything except the tensors, checked value by value.

/// The part of the state that a step changes before it changes the Gaussians.
struct StepPosition {
  int iteration = 0;        // last one done; random numbers depend on it and the seed (core/random.h)
  int step_iterations = 1;  // iterations of the last step, see --batch
  int sh_degree = 0;        // currently optimised; shN has coefficients up to the config's degree
  ViewOrder view_order;     // indices of the scene's training views, each at most once
  double loss_average = 0;  // 0.4 x new + 0.6 x old

  /// Returns the first iteration of the last step.
  int first_of_step() const { return iteration - step_iterations + 1; }
};

/// The state of a training, except the tensors and their data.
struct StateValues : StepPosition {
  ViewRatios view_ratios;   // where memory is limited; all 0 in checkpoints of early versions
  double elapsed_s = 0;     // training time, over all sessions
  std::string training_id;  // ModelFolder::training_id(); empty in checkpoints of early versions
  // Number of iterations, the last ones of the last step, whose density control is still pending, because the session
  // ended before it.
  int n_density_pending = 0;
  std::int64_t n_removed = 0;  // invalid Gaussians that were removed (train/density/row_edit.h)
  std::int64_t count_cap = 0;  // limit of the count for lack of memory; 0 = no limit
  nlohmann::ordered_json kernel_selection = nlohmann::ordered_json::object();
};

/// Numbers are at least 0 and finite, iterations at most `iteration`.
struct CheckpointHeader : StateValues {
  TrainConfig config;
  std::int64_t n_gaussians = 0;  // at least 1
  std::int64_t adam_steps = 0;
  std::int64_t appearance_steps = 0;
  std::vector<std::int64_t> appearance_last_steps;  // each from 0 to appearance_steps
  nlohmann::ordered_json scene;
};

/// Returns the value of the header's key "view_ratios", which is missing if no view was counted.
nlohmann::ordered_json ratios_to_json(const ViewRatios& ratios);

/// Reads the values of a checkpoint's header. @throws InputError, beginning with `place`, if one is missing, of the
/// wrong type or out of range
CheckpointHeader parse_checkpoint_header(const nlohmann::ordered_json& header, const std::string& place);

}  // namespace b3dgs
