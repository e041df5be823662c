// A model's folder on disk, laid out as the original 3DGS does: the one place that knows file names.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "model/evaluation.h"
#include "scene/scene.h"
#include "train/config/train_config.h"

namespace b3dgs {

/// What views were measured on. Two measurements compare where these are the same.
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
  std::filesystem::path log() const { return root_ / "train.jsonl"; }

  /// Iterations that have a PLY, or a checkpoint file (valid or not), ascending.
  std::vector<int> ply_iterations() const;
  std::vector<int> checkpoint_iterations() const;

  /// Whether there is a PLY or a checkpoint: hours of work.
  bool holds_model() const { return !ply_iterations().empty() || !checkpoint_iterations().empty(); }

  /// The training that the folder belongs to (training_id.h), from training.json; empty in folders of early versions.
  std::string training_id() const;
  void write_training_id(const std::string& id) const;

  /// input.ply, cameras.json (test cameras first), cfg_args, config.json.
  void write_inputs(const TrainConfig& config, const Scene& scene) const;

  /// The config a model was trained with. @throws InputError if config.json is missing or wrong.
  TrainConfig read_config() const;

  /// results.json and per_view.json, which have an entry "ours_N" or "ours_N_VARIANT" for what was measured.
  std::array<std::filesystem::path, 2> results() const { return {root_ / "results.json", root_ / "per_view.json"}; }

  /// Folders of images by the kind of their cameras, each with folders named likewise.
  std::array<std::filesystem::path, 3> image_sets() const {
    return {root_ / "test", root_ / "train", root_ / "interpolated"};
  }

  /// The key of an iteration's results: "ours_N" for the views and sizes that the model was trained with. `variant`
  /// sets others apart, as "ours_N_VARIANT", with "_2", "_3", ... behind it where that key holds results of another
  /// source.
  std::string results_key(int iteration, const std::string& variant = "", const EvaluationSource& source = {}) const;

  /// Adds results to results.json, with where they come from, and to per_view.json. @throws IoError
  void write_results(const std::string& key, const Evaluation& evaluation, const EvaluationSource& source) const;

 private:
  std::filesystem::path root_;
};

}  // namespace b3dgs
