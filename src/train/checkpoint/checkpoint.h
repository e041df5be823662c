// The file format of a checkpoint is a JSON header and named tensors, each with a checksum.
//
//   8 bytes   "B3DGSCKP"
//   uint32    version of the layout
//   uint32    CRC-32 of the header
//   uint64    bytes of the header
//   header    JSON with the caller's fields and, under "tensors", name, dtype, shape, bytes and CRC-32 of each
//             tensor. May end in spaces, because its length is fixed before the checksums are known.
//   tensors   one after the other, in the header's order, row-major, up to the end of the file
//
// Numbers are little-endian.
#pragma once

#include <torch/types.h>

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "config/train_config.h"
#include "core/files/atomic_file.h"
#include "model/checkpoint/checkpoint_header.h"  // read_checkpoint_header(), verify_checkpoint_file()
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/checkpoint/train_state.h"

namespace b3dgs {

struct CheckpointFile {
  nlohmann::ordered_json header = nlohmann::ordered_json::object();
  std::vector<std::pair<std::string, torch::Tensor>> tensors;  // name and values, on the CPU
};

/// Description of a tensor in the header.
struct TensorEntry {
  std::string name;
  torch::ScalarType type = torch::kFloat32;  // float32, int32 or int64
  std::vector<std::int64_t> shape;
};

/// Writes a checkpoint piece by piece, for tensors that are never completely in host memory. The file appears as a
/// whole at commit(), or not at all.
class CheckpointFileWriter {
 public:
  /// Opens a temporary file. @throws IoError
  CheckpointFileWriter(const std::filesystem::path& path, nlohmann::ordered_json header,
                       const std::vector<TensorEntry>& tensors);

  /// Appends the next bytes of the tensors. @throws IoError
  void append(const void* data, std::uint64_t bytes);

  /// Writes the header with its checksums. Call this after the last byte. Only commit() may follow. @throws IoError
  void finish();

  /// Moves the file to its path. @throws IoError
  void commit() { file_.commit(); }

 private:
  std::string header_text() const;

  nlohmann::ordered_json header_;
  std::size_t header_bytes_ = 0;
  std::size_t tensor_ = 0;  // index of the current tensor
  std::uint64_t left_ = 0;  // remaining bytes of this tensor
  AtomicFile file_;
};

/// Reads and checks the whole file. @throws InputError with the reason if it is damaged
CheckpointFile read_checkpoint_file(const std::filesystem::path& path);

// Checks whether a checkpoint belongs to a scene, and finds changes in the scene since it was written.

/// Returns the data that identify a scene in a checkpoint. Some of it must be equal, so that view indices and image
/// sizes have the same meaning and the Gaussians fit the views. The checksum of the points and the fingerprints of all
/// photographs and masks (model/model_folder.h) only detect changes. The caller may add "depth_maps", a list of
/// fingerprints.
nlohmann::ordered_json scene_fingerprint(const Scene& scene);

/// Returns the frame of a checkpoint's Gaussians, in which the scene has to be loaded (SceneOptions::frame). `place`
/// names the file in errors. @throws InputError if the header has no valid frame
CoordinateFrame checkpoint_frame(const nlohmann::ordered_json& header, const std::string& place);

/// Checks that the scene fits a checkpoint with this header. Images need not be loaded. @throws InputError if the
/// checkpoint was trained on other views, or with other poses, intrinsics or scene extent
void check_scene(const nlohmann::ordered_json& header, const Scene& scene, const std::string& place);

/// Returns warnings, one line each, about photographs, masks, depth maps and points that have changed since a
/// checkpoint with this header was written. Data that the header does not list count as unchanged. Masks and depth maps
/// may also have been added or removed.
std::vector<std::string> scene_changes(const nlohmann::ordered_json& header, const nlohmann::ordered_json& fingerprint);

// Reading and writing of the training state.

/// Content of a checkpoint.
struct Checkpoint {
  nlohmann::ordered_json header;
  TrainConfig config;
  TrainState state;
};

/// Returns the header of a checkpoint, without the list of tensors.
nlohmann::ordered_json checkpoint_header(const TrainConfig& config, const TrainState& state,
                                         const nlohmann::ordered_json& fingerprint);

using TakePiece = std::function<void(const void* piece, std::size_t bytes)>;

/// A tensor to be written. It is either in `values`, or in memory only while `read` passes its bytes, in pieces. All
/// tensors of a file must be of the same kind. `read` is called on the calling thread, in file order, unless the file
/// cannot be written.
struct CheckpointTensor {
  TensorEntry entry;
  torch::Tensor values;
  std::function<void(const TakePiece& take)> read{};
};

/// Returns the tensors of a state, in file order.
std::vector<CheckpointTensor> checkpoint_tensors(const TrainState& state);

/// Returns the size of these tensors in bytes, with the rows of all ranks.
std::int64_t checkpoint_bytes(const TrainState& state);

/// Checks that a checkpoint of this iteration with the options `saved` can be resumed with `wanted`. @throws InputError
/// if it cannot
void check_resume_options(const TrainConfig& saved, int iteration, const TrainConfig& wanted, const std::string& place);

/// Reads a checkpoint onto `device`. @throws InputError with the reason if the file is damaged or does not fit the
/// scene (check_scene())
Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device);

/// Removes old checkpoints after that of `iteration` was written. Of those of the training `training_id` up to this
/// iteration, the newest `keep` stay. Checkpoints of --checkpoint_iterations stay and are not counted. Checkpoints of
/// other trainings, later ones and damaged ones stay, too.
void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep);

/// Returns the newest valid checkpoint of the folder, or an empty path. Damaged ones are reported to `on_message`.
std::filesystem::path newest_valid_checkpoint(const ModelFolder& folder,
                                              const std::function<void(const std::string&)>& on_message);

}  // namespace b3dgs
