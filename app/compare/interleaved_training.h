// Trainers that take turns, so that whatever slows the machine down slows all of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/terminal/progress.h"
#include "compare/comparison.h"
#include "core/files/folder_lock.h"
#include "train/trainer.h"

namespace b3dgs {

/// All configurations of one seed, in one process: the device holds their models and views at the same time.
class InterleavedTraining {
 public:
  /// Each continues from its newest checkpoint, if it has one. `scene`, `status` must outlive this.
  InterleavedTraining(const ComparisonPlan& plan, std::int64_t seed, const Scene& scene, StatusLine& status);

  /// Trains all to the end or to the stop signal, which leaves a checkpoint of each. True if it ran to the end.
  bool run(double reading_s, const nlohmann::ordered_json& machine);

 private:
  struct Turn {
    Configuration configuration;
    ModelFolder folder;
    std::unique_ptr<FolderLock> lock;
    std::unique_ptr<Trainer> trainer;
    TrainResult result;
    EtaHistory eta;
  };

  void add(const ComparisonPlan& plan, const Configuration& configuration, std::int64_t seed, const Scene& scene,
           std::optional<std::int64_t> image_budget);
  bool take_turns();
  void write_checkpoints();
  void show(Turn& turn, const TrainProgress& progress);

  const Scene& scene_;
  StatusLine& status_;
  const int iterations_, chunk_;
  const std::size_t seed_index_;
  std::string label_;                         // "seed 0"
  std::vector<std::unique_ptr<Turn>> turns_;  // trainers report to their own turn: its place must not change
};

/// Which of so many configurations has a turn's first place. It moves on by one each turn, and from one seed to the
/// next: no configuration is always the one that a process starts with.
std::size_t first_in_turn(std::size_t seed_index, int turn, std::size_t n_configurations);

/// A few steps of each configuration on a part of the scene, thrown away: whoever comes first in a process would
/// otherwise pay for the loading of kernels and libraries. Returns what loading the code that only a choice between
/// kernels needs took, ms: the first configuration that chooses pays it for all. 0 where none chooses or nothing is
/// loaded.
double warm_up(const ComparisonPlan& plan, const Scene& scene);

}  // namespace b3dgs
