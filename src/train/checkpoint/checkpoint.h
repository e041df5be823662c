// The container of a checkpoint: a JSON header and named tensors, each with a checksum.
//
//   8 bytes   "B3DGSCKP"
//   uint32    version of the layout
//   uint32    CRC-32 of the header
//   uint64    bytes of the header
//   header    JSON: the caller's fields, and under "tensors" name, dtype, shape, bytes and CRC-32 of each; may end in
//             spaces, since its length is fixed before the checksums are known
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
  std::vector<std::pair<std::string, torch::Tensor>> tensors;  // on the CPU
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

/// Reads and checks the whole file. @throws InputError with the reason if it is damaged
CheckpointFile read_checkpoint_file(const std::filesystem::path& path);

// Whether a checkpoint belongs to a scene, and what has changed in the scene since.

/// Identifies a scene in a checkpoint: what must be equal for view indices and image sizes to have the same meaning and
/// for the Gaussians to fit the views, and to detect changes a checksum of the points and the fingerprints of all
/// photographs and masks (model/model_folder.h). The caller may add "depth_maps", a list of fingerprints.
nlohmann::ordered_json scene_fingerprint(const Scene& scene);

/// The frame of a checkpoint's Gaussians, in which the scene has to be loaded (SceneOptions::frame): that of the world
/// for checkpoints of early versions. @throws InputError
CoordinateFrame checkpoint_frame(const nlohmann::ordered_json& header, const std::string& place);

/// @throws InputError if a checkpoint with this header was trained on other views than the scene's, or with other poses
/// or intrinsics. Images need not be loaded.
void check_scene(const nlohmann::ordered_json& header, const Scene& scene, const std::string& place);

/// Warnings, one line each, about photographs, masks, depth maps and points that have changed since a checkpoint with
/// this header was written. What the header does not list, as in early versions, counts as unchanged. A mask or depth
/// map may also have been added or be gone.
std::vector<std::string> scene_changes(const nlohmann::ordered_json& header, const nlohmann::ordered_json& fingerprint);

// Reads and writes the training state.

struct Checkpoint {
  nlohmann::ordered_json header;
  TrainConfig config;
  TrainState state;
};

/// The header of a checkpoint, without the list of tensors.
nlohmann::ordered_json checkpoint_header(const TrainConfig& config, const TrainState& state,
                                         const nlohmann::ordered_json& fingerprint);

using TakePiece = std::function<void(const void* piece, std::size_t bytes)>;

/// A tensor to be written: `values`, or one that is in memory only while `read` passes its bytes, in pieces. A file has
/// one kind only. `read` is called on the calling thread, in file order, unless the file cannot be written.
struct CheckpointTensor {
  TensorEntry entry;
  torch::Tensor values;
  std::function<void(const TakePiece& take)> read{};
};

/// The tensors of a state, in file order.
std::vector<CheckpointTensor> checkpoint_tensors(const TrainState& state);

/// Bytes of these tensors, with the rows of all ranks.
std::int64_t checkpoint_bytes(const TrainState& state);

/// @throws InputError if a checkpoint with these options, of this iteration, cannot be resumed with `wanted`
void check_resume_options(const TrainConfig& saved, int iteration, const TrainConfig& wanted, const std::string& place);

/// Reads a checkpoint onto `device`. @throws InputError with the reason if the file is damaged or was trained on other
/// views than the scene's
Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device);

/// Removes what the checkpoint of `iteration`, just written, makes superfluous: of the training `training_id` all but
/// the newest `keep` up to it. Checkpoints of --checkpoint_iterations are not counted and stay, as do those of other
/// trainings, later ones and damaged ones.
void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep);

/// The newest valid checkpoint of the folder, or an empty path. Damaged ones are reported to `on_message`.
std::filesystem::path newest_valid_checkpoint(const ModelFolder& folder,
                                              const std::function<void(const std::string&)>& on_message);

}  // namespace b3dgs
