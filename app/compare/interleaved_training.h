// Trains several configurations in turns, so that changes in the speed of the machine affect all of them alike.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "app/terminal/progress.h"
#include "compare/comparison.h"
#include "core/files/folders.h"
#include "dist/communicator.h"
#include "train/trainer.h"

namespace b3dgs {

/// Trains all configurations of one seed in one process. All models are in memory at the same time.
class InterleavedTraining {
 public:
  /// Each configuration resumes from its newest checkpoint, if it has one. `scene` and `status` must outlive this.
  InterleavedTraining(const ComparisonPlan& plan, std::int64_t seed, const Scene& scene, StatusLine& status);

  /// Trains all configurations to the end, or until a stop signal, after which each has a checkpoint. Returns true if
  /// training is complete.
  bool run(double reading_s, const nlohmann::ordered_json& machine);

 private:
  struct Turn {
    Configuration configuration;
    ModelFolder folder;
    std::string label;  // "NAME, seed 0: "
    Eta eta;
    std::unique_ptr<FolderLock> lock{};
    std::unique_ptr<Trainer> trainer{};
    TrainResult result{};
    int iterations() const { return configuration.config.iterations; }
  };

  void add(const ComparisonPlan& plan, const Configuration& configuration, std::int64_t image_budget);
  bool take_turns();
  void write_checkpoints();
  void show(Turn& turn, const TrainProgress& progress);

  const Scene& scene_;
  StatusLine& status_;
  const std::unique_ptr<Communicator> ranks_ = Communicator::alone();
  const int iterations_, chunk_;  // iterations_: of the longest configuration
  const std::int64_t seed_;
  const std::size_t seed_index_;
  std::vector<std::unique_ptr<Turn>> turns_;  // pointers, since the trainers' hooks refer to their Turn
};

/// The command that resumes a comparison: "b3dgs compare --resume -m OUTPUT".
std::string resume_command(const ComparisonPlan& plan);

/// Index of the configuration that comes first in a turn. It advances with each turn and each seed, so that no
/// configuration always trains first.
std::size_t first_in_turn(std::size_t seed_index, int turn, std::size_t n_configurations);

/// Runs a few steps of each configuration on a part of the scene and discards them; otherwise the configuration that
/// trains first would bear the loading of kernels and libraries. Returns the time of loading kernels that only
/// configurations with a choice of kernels need, ms; 0 if there are none.
double warm_up(const ComparisonPlan& plan, const Scene& scene);

}  // namespace b3dgs
