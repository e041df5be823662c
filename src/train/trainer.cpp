#include "train/trainer.h"

#include <torch/cuda.h>

#include <chrono>

#include "train/checkpoint/checkpoint.h"
#include "train/threads.h"
#include "train/trainer_impl.h"

namespace b3dgs {

double steady_clock_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void wait_for(torch::Device device) {
  if (device.is_cuda()) torch::cuda::synchronize();
}

Trainer::Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks) {
  set_compute_threads(config.threads);
  TrainConfig resolved = config;  // what depends on the device is decided by its name: the default tile, for one
  resolved.device = device_name(choose_device(config.device));
  impl_ = std::make_unique<Impl>(resolved, scene, std::move(folder), std::move(hooks));
}
Trainer::~Trainer() = default;

std::vector<std::string> Trainer::resume(const std::filesystem::path& checkpoint) {
  Impl& own = *impl_;
  Checkpoint read = read_checkpoint(checkpoint, own.scene, own.device);
  if (read.config.sh_degree != own.config.sh_degree) {
    input_error(checkpoint.string(), ": holds a model of SH degree ", read.config.sh_degree, ", --sh_degree is ",
                own.config.sh_degree, "; resume with the same degree");
  }
  if (read.state.iteration > own.config.iterations) {
    input_error(checkpoint.string(), ": is at iteration ", read.state.iteration, ", beyond --iterations ",
                own.config.iterations, "; give a larger number");
  }
  own.fingerprint = scene_fingerprint(own.scene);
  const std::vector<std::string> changed = changed_photographs(read_checkpoint_header(checkpoint), own.fingerprint);
  if (!changed.empty()) {
    own.warn(detail::concat(changed.size(), " of ", own.scene.train.size(),
                            " photographs have changed since this checkpoint was written, ", changed.front(),
                            changed.size() > 1 ? " the first; " : "; ", "training goes on with them as they are now"));
  }
  own.state = std::move(read.state);
  own.resumed_s = own.state.elapsed_s;
  own.resumed = checkpoint;
  own.result.checkpoint = checkpoint;
  own.result.first_iteration = own.state.iteration;
  own.kernels.restore(own.state.kernel_selection, checkpoint.string());
  own.changed_options = config_differences(read.config, own.config);
  return own.changed_options;
}

void Trainer::step() {
  Impl& own = *impl_;
  if (own.state.gaussians.size() == 0) own.start();
  own.time.train([&] { own.step(); });
  own.time.train([&] { own.control_density(); });
  own.collect_times(own.timer.take());
}

void Trainer::wait() {
  impl_->settle_loss();
  impl_->collect_times(impl_->timer.wait());
}

std::string Trainer::describe_images() const {
  return "for training " + describe(impl_->images.places()) + "; for testing " + describe(places_of(impl_->scene.test));
}

std::int64_t Trainer::n_gaussians() const {
  return impl_->state.gaussians.size();
}

int Trainer::sh_degree() const {
  return impl_->state.sh_degree;
}

TrainResult Trainer::run() {
  return run_until(impl_->config.iterations);
}

TrainResult Trainer::run_until(int iteration) {
  Impl& own = *impl_;
  TrainResult& result = own.result;
  B3DGS_CHECK(iteration <= own.config.iterations, "iteration ", iteration, " of ", own.config.iterations);
  own.begin();
  while (own.state.iteration < iteration && !result.interrupted) own.iterate();
  own.time.finish_training();
  wait();
  own.time.output([&] { own.finish_files(); });
  result.train_s = own.time.train_s();
  result.output_s = own.time.output_s();
  result.iteration = own.state.iteration;
  result.n_gaussians = own.state.gaussians.size();
  result.peak_memory_bytes = own.memory->use().peak_reserved;
  result.n_removed = own.state.n_removed;
  return result;
}

void Trainer::Impl::iterate() {
  try {
    time.train([&] { step(); });
    time.train([&] { report("training"); });
    const OutputPlan plan = output_plan(config, state.iteration, !scene.test.empty());
    const bool uses_device = plan.statistics || plan.kernel_times || plan.evaluate || plan.save;
    // On a GPU this waits for most of the step.
    if (plan.log || uses_device || plan.checkpoint || is_stopped()) time.train([&] { settle_loss(); });
    if (uses_device || plan.checkpoint || is_stopped()) time.train([&] { settle(); });
    if (uses_device) {
      time.output([&] { write_outputs(plan); });
    } else if (plan.log) {
      // The device works meanwhile. A line is not worth waiting for it, and leaving out those microseconds would hide
      // as many of the step's.
      time.train([&] { write_outputs(plan); });
    }
    if (hooks.on_result && state.iteration == config.iterations) {
      time.output([&] { try_to_write(hooks.on_result); });
    }
    // A last PLY that is not there is written when the training is continued, and is of the model before this.
    if (failed.empty() || state.iteration < config.iterations) time.train([&] { control_density(); });
    result.interrupted = is_ending = state.iteration < config.iterations && is_stopped();
    const bool is_due = config.checkpoint_minutes > 0 && !writer.is_busy() &&
                        time.train_s() - checkpoint_s >= 60 * config.checkpoint_minutes;
    if (plan.checkpoint || result.interrupted || is_due) time.output([&] { write_checkpoint(); });
    if (hooks.wait_for_files) writer.wait();
    note_files();
  } catch (const LossError&) {
    throw;
  } catch (...) {
    end_with_checkpoint();
  }
}

int Trainer::iteration() const {
  return impl_->state.iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  Impl& own = *impl_;
  B3DGS_CHECK(own.log, "the training has not begun");
  return own.without_bad_gaussians([&] {
    return evaluate_views(own.rasterizer, own.settled().gaussians, views,
                          evaluation_settings(own.config, own.state.sh_degree), on_rendered);
  });
}

std::filesystem::path Trainer::write_checkpoint() {
  Impl& own = *impl_;
  B3DGS_CHECK(own.log, "the training has not begun");
  own.is_ending = true;
  own.write_checkpoint();
  own.is_ending = false;
  if (!own.failed.empty()) throw IoError(own.failed.front().error + own.last_checkpoint());
  return own.result.checkpoint;
}

}  // namespace b3dgs
