#include "train/team.h"

#include "train/checkpoint/checkpoint.h"
#include "train/density_control.h"

namespace b3dgs {

void Team::render_on_first(const std::function<void(const RenderModelFn&)>& work) {
  work([this](const CameraView& view, const RenderSettings& settings) {
    return training_.rasterizer.forward(training_.flushed_state().gaussians, view, settings);
  });
}

void Team::write_checkpoint() {
  const TrainState& whole = training_.flushed_state();
  training_.recorder.write_checkpoint(checkpoint_header(config_, whole, training_.fingerprint),
                                      checkpoint_tensors(whole));
}

std::int64_t Team::remove_invalid_rows(std::int64_t row) {
  return remove_invalid_gaussians(row, training_.scene.extent, state_.gaussians, state_.adam, state_.statistics);
}

void Team::run_round(int iteration, std::int64_t limit, const std::function<void(const DensityRound&)>& on_planned) {
  const DensityRound round = training_.density->plan_round(state_.gaussians, state_.statistics, iteration, limit);
  on_planned(round);
  reserve_rows(training_, round.edit, limit);
  apply_reserved(training_, round.edit, iteration);
}

}  // namespace b3dgs
