// Stages of a training step, and who is told when one begins. The rasterizer marks its own passes; what the marks are
// for (events on a stream, a clock) is the listener's affair.
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

/// As in train.jsonl.
inline constexpr std::array<const char*, 9> kStageNames{
    "upload", "project", "bin", "blend_forward", "loss", "blend_backward", "project_backward", "optimizer", "densify"};
inline constexpr std::size_t kStageCount = kStageNames.size();

class StageRecorder {
 public:
  virtual ~StageRecorder() = default;
  /// What is queued from now on belongs to `stage`, and no longer to the one before.
  virtual void begin(Stage stage) = 0;
  /// What is queued from now on belongs to no stage.
  virtual void end() = 0;
};

inline void begin_stage(StageRecorder* recorder, Stage stage) {
  if (recorder != nullptr) recorder->begin(stage);
}
inline void end_stage(StageRecorder* recorder) {
  if (recorder != nullptr) recorder->end();
}

}  // namespace b3dgs
