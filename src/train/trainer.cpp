#include "train/trainer.h"

#include <torch/cuda.h>

#include <chrono>

#include "train/checkpoint.h"
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
  own.state = std::move(read.state);
  own.resumed_s = own.state.elapsed_s;
  own.result.checkpoint = checkpoint;
  own.kernels.restore(own.state.kernel_selection, checkpoint.string());
  return config_differences(read.config, own.config);
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
  while (own.state.iteration < iteration && !result.interrupted) {
    own.time.train([&] { own.step(); });
    own.time.train([&] { own.report("training"); });
    const OutputPlan plan = output_plan(own.config, own.state.iteration, !own.scene.test.empty());
    const bool uses_device = plan.statistics || plan.kernel_times || plan.evaluate || plan.save;
    // On a GPU this waits for most of the step.
    if (plan.log || uses_device || plan.checkpoint || own.is_stopped()) own.time.train([&] { own.settle_loss(); });
    if (uses_device || plan.checkpoint || own.is_stopped()) own.time.train([&] { own.settle(); });
    if (uses_device) {
      own.time.output([&] { own.write_outputs(plan); });
    } else if (plan.log) {
      // The device works meanwhile. A line is not worth waiting for it, and leaving out those microseconds would hide
      // as many of the step's.
      own.time.train([&] { own.write_outputs(plan); });
    }
    if (own.hooks.on_result && own.state.iteration == own.config.iterations) own.time.output(own.hooks.on_result);
    own.time.train([&] { own.control_density(); });
    result.interrupted = own.state.iteration < own.config.iterations && own.is_stopped();
    if (plan.checkpoint || result.interrupted) own.time.output([&] { own.write_checkpoint(); });
  }
  own.time.finish_training();
  wait();
  result.train_s = own.time.train_s();
  result.output_s = own.time.output_s();
  result.iteration = own.state.iteration;
  result.n_gaussians = own.state.gaussians.size();
  result.peak_memory_bytes = own.memory->use().peak_reserved;
  return result;
}

int Trainer::iteration() const {
  return impl_->state.iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  Impl& own = *impl_;
  B3DGS_CHECK(own.log, "the training has not begun");
  return evaluate_views(own.rasterizer, own.settled().gaussians, views,
                        evaluation_settings(own.config, own.state.sh_degree), on_rendered);
}

std::filesystem::path Trainer::write_checkpoint() {
  B3DGS_CHECK(impl_->log, "the training has not begun");
  impl_->write_checkpoint();
  return impl_->result.checkpoint;
}

}  // namespace b3dgs
