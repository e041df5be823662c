// What a training tells: lines of the log, figures of the test views, PLYs, checkpoints, progress.

#include <cstdio>

#include "scene/ply.h"
#include "train/checkpoint.h"
#include "train/gaussian_model.h"
#include "train/trainer_impl.h"

namespace b3dgs {

/// What has to be there before the first step of this session; nothing when called again.
void Trainer::Impl::begin() {
  if (log) return;
  if (state.gaussians.size() == 0) start();
  folder.write_inputs(config, scene);
  log = std::make_unique<TrainLog>(folder.log(), state.iteration);
  logged_iteration = staged_iteration = state.iteration;
  if (state.iteration == config.iterations) {
    say(detail::concat("all ", config.iterations, " iterations are done; more need a larger --iterations"));
    result.ply = folder.ply(state.iteration);
  }
}

/// How uneven the load of the first view is: always the same one, so that only the training makes a difference.
void Trainer::Impl::log_load() {
  const TrainView& view = images.describe(0);
  RenderSettings settings = evaluation_settings(config, state.sh_degree);
  settings.keep_for_backward = false;
  try {
    rasterizer.forward(settled().gaussians, view.camera, settings);
  } catch (const NumericError& error) {
    fail(state.iteration, view.name, error.what());
  }
  log->write_event(state.iteration, "load_statistics", load_json(view.name, rasterizer.count_load()));
}

/// How long the candidates for the blends take by now, for whoever plots a training; nothing is decided.
void Trainer::Impl::log_kernel_times() {
  report("timing kernels");
  for (const CandidateTiming& timing : kernels.time_candidates(kernel_check_input())) {
    log->write_event(state.iteration, "kernel_times", to_json(timing));
  }
}

void Trainer::Impl::collect_times(const std::vector<StageTimes>& known) {
  for (const StageTimes& times : known) {
    stages.add(times);
    if (hooks.on_stage_times) hooks.on_stage_times(times);
  }
}

void Trainer::Impl::write_outputs(const OutputPlan& plan) {
  if (plan.statistics) log_load();
  if (plan.kernel_times) log_kernel_times();
  TrainLogLine line;
  if (plan.evaluate) {
    report("evaluating");
    result.evaluations.emplace_back(state.iteration, evaluate_views(rasterizer, settled().gaussians, scene.test,
                                                                    evaluation_settings(config, state.sh_degree)));
    const Evaluation& evaluation = result.evaluations.back().second;
    folder.write_results(folder.results_key(state.iteration), evaluation,
                         evaluation_source(config, scene.test, "test"));
    line.test_quality = evaluation.mean;
    char text[120];
    std::snprintf(text, sizeof text, "iteration %d: PSNR %.2f dB, SSIM %.4f on %zu test views", state.iteration,
                  evaluation.mean.psnr, evaluation.mean.ssim, evaluation.views.size());
    say(text);
  }
  if (plan.log) {
    line.iteration = state.iteration;
    line.loss = state.loss_average;
    line.ms = 1e3 * (time.train_s() - logged_s) / std::max(1, state.iteration - logged_iteration);
    logged_ms = line.ms;
    line.count = state.gaussians.size();
    line.peak_memory_bytes = memory->use().peak_reserved;
    line.elapsed_s = elapsed_s();
    collect_times(timer.take());
    line.stages = stages.take(state.iteration - staged_iteration);
    if (line.stages) staged_iteration = state.iteration;
    line.kernel = kernels.forward_name();
    line.backward_kernel = kernels.backward_name();
    log->write(line);
    logged_iteration = state.iteration;
    logged_s = time.train_s();
  }
  if (plan.save) {
    report("saving");
    result.ply = folder.ply(state.iteration);
    write_splat_ply(result.ply, to_splat_cloud(settled().gaussians));
  }
}

void Trainer::Impl::write_checkpoint() {
  report("checkpoint");
  settle_loss();
  state.elapsed_s = elapsed_s();
  const std::filesystem::path path = folder.checkpoint(state.iteration);
  b3dgs::write_checkpoint(path, config, settled(), scene);
  result.checkpoint = path;
  remove_superseded_checkpoints(folder, state.iteration, config.keep_checkpoints);
}

void Trainer::Impl::report(const char* activity) const {
  if (!hooks.on_progress) return;
  TrainProgress progress;
  progress.iteration = state.iteration;
  progress.iterations = config.iterations;
  progress.loss = state.loss_average;
  progress.n_gaussians = state.gaussians.size();
  progress.held_at = state.held_at;
  progress.elapsed_s = time.train_s();
  progress.activity = activity;
  hooks.on_progress(progress);
}

}  // namespace b3dgs
