// Stages of a training step, and the interface that is notified when one begins. The rasterizer reports its own five,
// from projection to backward projection, and training reports the others. A single list defines the order and the
// names in train.jsonl, in the report and in the benchmark.
#pragma once

#include <array>
#include <cstddef>

namespace b3dgs {

enum class Stage {
  kUpload,
  kProject,
  kBin,
  kBlendForward,
  kLoss,
  kBlendBackward,
  kProjectBackward,
  kOptimizer,
  kDensify,
};

/// Names in train.jsonl.
inline constexpr std::array<const char*, 9> kStageNames{
    "upload", "project", "bin", "blend_forward", "loss", "blend_backward", "project_backward", "optimizer", "densify"};
inline constexpr std::size_t kStageCount = kStageNames.size();

class StageRecorder {
 public:
  virtual ~StageRecorder() = default;
  /// Work queued from now on belongs to `stage`, which ends the previous stage.
  virtual void begin(Stage stage) = 0;
  /// Work queued from now on belongs to no stage.
  virtual void end() = 0;
};

inline void begin_stage(StageRecorder* recorder, Stage stage) {
  if (recorder != nullptr) recorder->begin(stage);
}
inline void end_stage(StageRecorder* recorder) {
  if (recorder != nullptr) recorder->end();
}

}  // namespace b3dgs
