// A model's folder on disk, laid out as the original 3DGS does: the one place that knows file names.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/scene.h"
#include "train/evaluate.h"
#include "train/train_config.h"

namespace b3dgs {

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

  /// Creates the folder and proves that it can be written to. @throws IoError
  void create() const;

  /// input.ply, cameras.json (test cameras first), cfg_args, config.json.
  void write_inputs(const TrainConfig& config, const Scene& scene) const;

  /// The config a model was trained with. @throws InputError if config.json is missing or wrong.
  TrainConfig read_config() const;

  /// Adds results of one iteration to results.json and per_view.json under "ours_N".
  void write_results(int iteration, const Evaluation& evaluation) const;

 private:
  std::filesystem::path root_;
};

}  // namespace b3dgs
