// The folder of a trained model, and the image quality of its renders.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

struct ImageQuality {
  double psnr = 0, ssim = 0;               // PSNR in dB
  double sharpness = 0;                    // of the render relative to the photograph (train/quality/metrics.h)
  std::optional<double> corrected_psnr{};  // dB, of the render after its colours are fitted to the photograph
  std::optional<double> lpips{};           // from Evaluation::lpips_network
};

struct ViewQuality {
  std::string name;
  ImageQuality quality;
};

struct Evaluation {
  std::vector<ViewQuality> views;         // views with a valid pixel to compare
  ImageQuality mean;                      // of `views`; 0 if there are none
  bool fits_left_half = false;            // only right halves were measured, with colours fitted on the left ones
  std::string lpips_network{};            // file name; empty: LPIPS was not computed
  std::vector<std::string> unmeasured{};  // names of views without a valid pixel
};

/// Returns "iteration 300: PSNR 23.20 dB, SSIM 0.7786, sharpness 0.81 on 7 test views; 2 without a valid pixel (first:
/// b.png)".
std::string describe_quality(int iteration, const Evaluation& evaluation);

// The folder, with the layout of the original 3DGS.

/// The photographs of an evaluation. Two evaluations are comparable if these are the same.
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
  std::filesystem::path ply(int iteration) const {
    return root_ / "point_cloud" / ("iteration_" + std::to_string(iteration)) / "point_cloud.ply";
  }
  std::filesystem::path checkpoint(int iteration) const {
    return root_ / "checkpoints" / ("iteration_" + std::to_string(iteration) + ".b3dgs");
  }
  std::filesystem::path cameras() const { return root_ / "cameras.json"; }
  std::filesystem::path poses() const { return root_ / "poses.json"; }              // refined poses (cameras_json.h)
  std::filesystem::path photographs() const { return root_ / "photographs.json"; }  // photograph_fingerprint()
  std::filesystem::path exposures() const { return root_ / "exposure.json"; }       // of the last PLY
  std::filesystem::path exposures(int iteration) const { return ply(iteration).replace_filename("exposure.json"); }
  std::filesystem::path log() const { return root_ / "train.jsonl"; }

  /// Returns the iterations with a PLY, or with a checkpoint file (valid or not), ascending.
  std::vector<int> ply_iterations() const;
  std::vector<int> checkpoint_iterations() const;

  /// Returns whether there is a PLY or a checkpoint, which must not be overwritten by accident.
  bool holds_model() const { return !ply_iterations().empty() || !checkpoint_iterations().empty(); }

  /// Returns the ID of the training that the folder belongs to, from training.json; empty in folders of early versions.
  std::string training_id() const;
  /// Returns the world units per unit of the training's frame; nothing in folders of early versions.
  std::optional<double> training_unit() const;
  void write_training(const std::string& id, double unit) const;

  /// Writes input.ply, cameras.json (test cameras first), photographs.json, cfg_args, config.json and, if the scene has
  /// one, georeference.json. @throws IoError
  void write_inputs(const TrainConfig& config, const Scene& scene) const;

  /// Writes cameras.json with the refined poses of the training views, and poses.json. @throws IoError
  void write_poses(const Scene& scene, const std::vector<View>& refined_train) const;
  /// Removes a file of an earlier session. Moves a file of the user aside.
  void clear(const std::filesystem::path& file) const;

  /// Returns whether there is a config.json, so a training was started here.
  bool has_config() const;

  /// Returns the configuration of the training. @throws InputError if config.json is missing or damaged
  TrainConfig read_config() const;

  /// Returns the paths of results.json and per_view.json, which have an entry "ours_N" or "ours_N_VARIANT" per
  /// evaluation.
  std::array<std::filesystem::path, 2> results() const { return {root_ / "results.json", root_ / "per_view.json"}; }

  /// Returns the folders of renders by kind of camera. Each has sub-folders "ours_N" or "ours_N_VARIANT".
  std::array<std::filesystem::path, 3> image_sets() const {
    return {root_ / "test", root_ / "train", root_ / "interpolated"};
  }

  /// Returns the key of an iteration's results: "ours_N" for the views and sizes of the training, "ours_N_VARIANT" for
  /// others. "_2", "_3", ... is appended if results of another source already use that key.
  std::string results_key(int iteration, const std::string& variant = "", const EvaluationSource& source = {}) const;

  /// Checks that write_results() will be able to read the files. @throws InputError
  void check_results() const;

  /// Adds results to results.json, with their source, and to per_view.json. @throws IoError
  void write_results(const std::string& key, const Evaluation& evaluation, const EvaluationSource& source) const;

 private:
  std::filesystem::path root_;
};

/// Returns number and rest of the name PREFIX + number + rest; -1 for other names.
std::pair<int, std::string> numbered_name(const std::string& name, std::string_view prefix);

/// Writes a JSON file atomically. `indent` -1 writes one line. @throws IoError
void write_json_file(const std::filesystem::path& path, const nlohmann::ordered_json& json, int indent = 2);

// Every training has a random ID, stored in the folder's training.json and in each of its checkpoints, so that no
// training continues in the folder of another model.

/// Returns whether a training may be resumed in `folder` from a checkpoint with this training ID. The folder must be
/// without a model, or have one of the same training. A folder or checkpoint of an early version has no ID (""), so the
/// checkpoint has to be in that folder.
bool may_continue_in(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                     const std::string& training_id);

/// @throws InputError unless may_continue_in().
void check_training_id(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                       const std::string& training_id);

/// Returns the ID of a training that begins in `folder`, or is resumed there from a checkpoint with this ID. It is the
/// folder's own, or 16 new hexadecimal digits. @throws InputError if the folder has the model of another training
std::string claim_training_id(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                              const std::string& training_id);

/// Prevents a training that is resumed from an earlier checkpoint from overwriting files. Moves everything in the model
/// folder that belongs to iterations after `iteration` (checkpoints, PLYs, rendered images, results, lines of the log,
/// and reports on them) to a new folder set_aside/after_iteration_N_1 (_2, _3, ... if that exists). Returns this
/// folder, or "" if there is nothing of later iterations. @throws IoError
std::filesystem::path set_aside_after(const ModelFolder& folder, int iteration);

// Predicts whether the files of a training will fit on the disk.

/// Returns the bytes that this user can write to the file system of `folder`; -1 if unknown.
std::int64_t free_disk_bytes(const std::filesystem::path& folder);

/// Returns the size of a PLY in bytes, without its header.
std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree);

/// The files of the Gaussians that a training starts with.
struct FirstFiles {
  std::int64_t n_gaussians = 0;
  std::int64_t ply_bytes = 0, checkpoint_bytes = 0;  // of one file each
};

/// Returns a warning of one line if `free_bytes` are too few for a PLY and `n_checkpoints` + 1 checkpoints (a new
/// checkpoint is written before the oldest is removed), or "".
std::string disk_warning(const std::filesystem::path& folder, std::int64_t free_bytes, const FirstFiles& files,
                         int n_checkpoints);

// Detects photographs that have changed since a model was trained on them.

/// Returns {"bytes", "crc32", "rest_crc32"}: the size of a photograph, the CRC-32 of its first 64 KiB, and that of the
/// rest. For a JPEG, PNG or WebP file, the rest is only the last 64 KiB, because an edit of a compressed image changes
/// the size or everything after it. In a file without compression, an edit may change a few bytes anywhere. Returns
/// null if the file cannot be read.
nlohmann::ordered_json photograph_fingerprint(const std::string& path);

/// Returns whether the fingerprints are of the same file. `before` may be of an early version, without "rest_crc32".
bool is_same_photograph(const nlohmann::ordered_json& before, const nlohmann::ordered_json& now);

/// Returns the names of views whose photographs have other fingerprints than in `file` (photographs.json of the model
/// folder). Returns none if that file is missing or damaged, as in models of early versions.
std::vector<std::string> changed_views(const std::filesystem::path& file, const std::vector<View>& views);

}  // namespace b3dgs
