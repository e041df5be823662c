#include "train/trainer.h"

#include <torch/cuda.h>

#include "train/checkpoint.h"
#include "train/threads.h"
#include "train/trainer_impl.h"

namespace b3dgs {

Trainer::Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks) {
  set_compute_threads(config.threads);
  impl_ = std::make_unique<Impl>(config, scene, std::move(folder), std::move(hooks));
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
  own.result.checkpoint = checkpoint;
  own.kernels.restore(own.state.kernel_selection, checkpoint.string());
  return config_differences(read.config, own.config);
}

void Trainer::step() {
  Impl& own = *impl_;
  if (own.state.gaussians.size() == 0) own.start();
  own.timed([&] { own.step(); });
  own.timed([&] { own.control_density(); });
  own.collect_times(own.timer.take());
}

void Trainer::wait() {
  impl_->settle_loss();
  impl_->collect_times(impl_->timer.wait());
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
    own.timed([&] { own.step(); });
    own.report("training");
    const OutputPlan plan = output_plan(own.config, own.state.iteration, !own.scene.test.empty());
    if (plan.log || plan.statistics || plan.evaluate || plan.save || plan.checkpoint || own.is_stopped())
      own.settle_loss();
    auto start = std::chrono::steady_clock::now();
    own.write_outputs(plan);
    result.output_s += seconds_since(start);
    own.timed([&] { own.control_density(); });
    start = std::chrono::steady_clock::now();
    result.interrupted = own.state.iteration < own.config.iterations && own.is_stopped();
    if (plan.checkpoint || result.interrupted) own.write_checkpoint();
    result.output_s += seconds_since(start);
  }
  if (own.device.is_cuda()) own.timed([] { torch::cuda::synchronize(); });
  wait();
  result.iteration = own.state.iteration;
  result.n_gaussians = own.state.gaussians.size();
  return result;
}

int Trainer::iteration() const {
  return impl_->state.iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  Impl& own = *impl_;
  B3DGS_CHECK(own.log, "the training has not begun");
  return evaluate_views(own.rasterizer, own.state.gaussians, views,
                        evaluation_settings(own.config, own.state.sh_degree), on_rendered);
}

std::filesystem::path Trainer::write_checkpoint() {
  B3DGS_CHECK(impl_->log, "the training has not begun");
  impl_->write_checkpoint();
  return impl_->result.checkpoint;
}

}  // namespace b3dgs
