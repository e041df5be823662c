// What a training tells: lines of the log, figures of the test views, PLYs, checkpoints, progress.

#include <cstdio>

#include "model/disk_space.h"
#include "model/set_aside.h"
#include "model/training_id.h"
#include "train/checkpoint/checkpoint.h"
#include "train/trainer_impl.h"

namespace b3dgs {

/// Marks the folder as the one of this training, and sets aside what it holds of later iterations.
void Trainer::Impl::claim_folder() {
  if (resumed.empty()) {
    state.training_id = new_training_id();
  } else {
    check_training_id(folder, resumed, state.training_id);
    state.training_id = training_id_for(folder);
    const std::filesystem::path aside = set_aside_after(folder, state.iteration);
    if (!aside.empty()) {
      say(detail::concat("what this folder held of iterations after ", state.iteration, " is now in ", aside.string()));
    }
  }
  folder.write_training_id(state.training_id);
}

/// What has to be there before the first step of this session; nothing when called again.
void Trainer::Impl::begin() {
  if (log) return;
  if (state.gaussians.size() == 0) start();
  if (fingerprint.is_null()) fingerprint = scene_fingerprint(scene);
  claim_folder();
  folder.write_inputs(config, scene);
  log = std::make_unique<TrainLog>(folder.log(), state.iteration);
  logged_iteration = staged_iteration = state.iteration;
  if (!resumed.empty()) {
    log->write_event(state.iteration, "resumed",
                     {{"kernel", kernels.forward_name()},
                      {"backward_kernel", kernels.backward_name()},
                      {"changed_options", changed_options}});
  }
  const std::string disk = disk_warning(folder.root(), free_disk_bytes(folder.root()), state.gaussians.size(),
                                        config.sh_degree, config.keep_checkpoints);
  if (!disk.empty()) warn(disk);
  // The run before ended between a step and its density control: what lay between is made up for.
  const bool wants_ply = output_plan(config, state.iteration, false).save && state.iteration > 0;
  const bool lacks_ply = wants_ply && !std::filesystem::exists(folder.ply(state.iteration));
  if (lacks_ply && (state.is_density_pending || state.iteration == config.iterations)) write_ply();
  if (state.is_density_pending) {
    control_density();
    if (state.iteration == config.iterations) write_checkpoint();
  }
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
  without_bad_gaussians([&] { rasterizer.forward(settled().gaussians, view.camera, settings); });
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
    result.evaluations.emplace_back(state.iteration, without_bad_gaussians([&] {
                                      return evaluate_views(rasterizer, settled().gaussians, scene.test,
                                                            evaluation_settings(config, state.sh_degree));
                                    }));
    const Evaluation& evaluation = result.evaluations.back().second;
    try_to_write([&] {
      folder.write_results(folder.results_key(state.iteration), evaluation,
                           evaluation_source(config, scene.test, "test"));
    });
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
    if (const std::string fault = log->take_fault(); !fault.empty()) {
      warn(fault + "; lines wait until it can be written to");
    }
    logged_iteration = state.iteration;
    logged_s = time.train_s();
  }
  if (plan.save) write_ply();
}

bool Trainer::Impl::has_room_for_copy(std::int64_t bytes) {
  const std::optional<std::int64_t> limit = memory->limit();
  // As much again stays for the training.
  return !is_last() && (!limit || *limit - memory->use().reserved >= 2 * bytes);
}

void Trainer::Impl::write_ply() {
  report("saving");
  writer.write_ply({WrittenFile::Kind::kPly, state.iteration, folder.ply(state.iteration), ""}, settled().gaussians,
                   has_room_for_copy(ply_bytes(state.gaussians.size(), config.sh_degree)));
  if (!is_last()) return;
  writer.wait();
  note_files();
}

void Trainer::Impl::write_checkpoint() {
  report("checkpoint");
  settle_loss();
  state.elapsed_s = elapsed_s();
  checkpoint_s = time.train_s();
  const TrainState& whole = settled();
  writer.write_checkpoint({WrittenFile::Kind::kCheckpoint, whole.iteration, folder.checkpoint(whole.iteration), ""},
                          checkpoint_header(config, whole, fingerprint), checkpoint_tensors(whole),
                          has_room_for_copy(checkpoint_bytes(whole.gaussians.size(), config.sh_degree)));
  if (!is_last()) return;
  writer.wait();
  note_files();
}

void Trainer::Impl::note_files() {
  for (WrittenFile& file : writer.take()) {
    const bool is_checkpoint = file.kind == WrittenFile::Kind::kCheckpoint;
    if (!file.error.empty()) {
      result.not_written.push_back(file.path);
      if (is_last() && file.iteration == state.iteration) {
        failed.push_back(file);
      } else {
        warn(file.error + (is_checkpoint
                               ? "; training goes on, the next checkpoint is written in its time" + last_checkpoint()
                               : "; training goes on without this PLY"));
      }
    } else if (is_checkpoint) {
      result.checkpoint = file.path;
      remove_superseded_checkpoints(folder, state.training_id, file.iteration, config.keep_checkpoints);
    } else {
      result.ply = file.path;
    }
  }
}

/// Waits for what is being written. @throws IoError if the last files cannot be
void Trainer::Impl::finish_files() {
  writer.wait();
  note_files();
  if (!failed.empty())
    throw IoError(failed.front().error + "; make room and continue with --resume auto" + last_checkpoint());
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
