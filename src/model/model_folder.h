// The folder of a trained model, with the layout of the original 3DGS. All file names are defined here.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "model/evaluation.h"
#include "scene/scene.h"

namespace b3dgs {

/// The photographs of an evaluation. Two evaluations can be compared if these are the same.
struct EvaluationSource {
  std::string source_path, images;
  int resolution = 0;         // --resolution
  int width = 0, height = 0;  // px, of the largest view
  std::string split;          // "test" or "train"
};

EvaluationSource evaluation_source(const TrainConfig& config, const std::vector<View>& views, const std::string& split);

class ModelFolder {
 public:
  explicit ModelFolder(std::filesystem::path root) : root_(std::move(root)) {}

  const std::filesystem::path& root() const { return root_; }
  std::filesystem::path ply(int iteration) const;         // point_cloud/iteration_N/point_cloud.ply
  std::filesystem::path checkpoint(int iteration) const;  // checkpoints/iteration_N.b3dgs
  std::filesystem::path cameras() const { return root_ / "cameras.json"; }
  std::filesystem::path poses() const { return root_ / "poses.json"; }              // refined poses (cameras_json.h)
  std::filesystem::path photographs() const { return root_ / "photographs.json"; }  // fingerprints (photographs.h)
  std::filesystem::path exposures() const { return root_ / "exposure.json"; }       // of the last PLY
  std::filesystem::path exposures(int iteration) const;                             // beside the PLY
  std::filesystem::path log() const { return root_ / "train.jsonl"; }

  /// Iterations with a PLY, or with a checkpoint file (valid or not), ascending.
  std::vector<int> ply_iterations() const;
  std::vector<int> checkpoint_iterations() const;

  /// Whether there is a PLY or a checkpoint, which must not be overwritten by accident.
  bool holds_model() const { return !ply_iterations().empty() || !checkpoint_iterations().empty(); }

  /// The training that the folder belongs to, from training.json; empty in folders of early versions.
  std::string training_id() const;
  void write_training_id(const std::string& id) const;

  /// Writes input.ply, cameras.json (test cameras first), photographs.json, cfg_args and config.json. @throws IoError
  void write_inputs(const TrainConfig& config, const Scene& scene) const;

  /// Writes cameras.json with the refined poses of the training views, and poses.json. @throws IoError
  void write_poses(const Scene& scene, const std::vector<View>& refined_train) const;
  /// Removes poses.json, or exposure.json, of an earlier session; moves one of the user's aside.
  void remove_poses() const;
  void remove_exposures() const;

  /// Whether there is a config.json: a training was started here.
  bool has_config() const;

  /// The configuration of the training. @throws InputError if config.json is missing or damaged
  TrainConfig read_config() const;

  /// results.json and per_view.json, which have an entry "ours_N" or "ours_N_VARIANT" for each evaluation.
  std::array<std::filesystem::path, 2> results() const { return {root_ / "results.json", root_ / "per_view.json"}; }

  /// Folders of renders by kind of camera; each has sub-folders "ours_N" or "ours_N_VARIANT".
  std::array<std::filesystem::path, 3> image_sets() const {
    return {root_ / "test", root_ / "train", root_ / "interpolated"};
  }

  /// The key of an iteration's results: "ours_N" for the views and sizes of the training, "ours_N_VARIANT" for others,
  /// followed by "_2", "_3", ... if that key is used by results of another source.
  std::string results_key(int iteration, const std::string& variant = "", const EvaluationSource& source = {}) const;

  /// Adds results to results.json, with their source, and to per_view.json. @throws IoError
  void write_results(const std::string& key, const Evaluation& evaluation, const EvaluationSource& source) const;

 private:
  std::filesystem::path root_;
};

// Every training has a random ID, stored in the folder's training.json and in each of its checkpoints, so that no
// training continues in a folder that holds another's model.

/// 16 random hexadecimal digits.
std::string new_training_id();

/// Whether a training may be resumed in `folder` from a checkpoint with this training ID: the folder holds no model, or
/// one of the same training. A folder or checkpoint of an early version has no ID (""): then the checkpoint has to be
/// one of the folder's own.
bool may_continue_in(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                     const std::string& training_id);

/// @throws InputError unless may_continue_in().
void check_training_id(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                       const std::string& training_id);

/// For a training that begins. @throws InputError if the folder holds a model
void check_holds_no_model(const ModelFolder& folder);

/// The ID of a training that is resumed in `folder`: the folder's own, or a new one if the folder holds no model or has
/// no ID.
std::string training_id_for(const ModelFolder& folder);

/// Resuming from an earlier checkpoint overwrites nothing: moves what the model folder holds of iterations after
/// `iteration` (checkpoints, PLYs, rendered images, results, lines of the log, and reports on them) to a new folder
/// set_aside/after_iteration_N_1 (_2, _3, ... if that exists), which is returned; empty if there is nothing of later
/// iterations. @throws IoError
std::filesystem::path set_aside_after(const ModelFolder& folder, int iteration);

}  // namespace b3dgs
