#include "train/trainer.h"

#include "model/formats/splat_formats.h"
#include "train/device.h"
#include "train/scene_limits.h"
#include "train/session.h"
#include "train/threads.h"

namespace b3dgs {

void check_options(const TrainConfig& config) {
  if (choose_device(config.device).is_cuda() && config.deterministic &&
      evaluation_settings(config, 0).backward_kernel != BackwardKernel::kPerBucket) {
    input_error("--deterministic: the backward kernel ", config.backward_kernel,
                " sums in an order that differs from run to run; use --backward_kernel per-bucket");
  }
  const bool grows = config.max_gaussians == 0 && config.gaussians_per_pixel == 0;
  if (config.strategy == "mcmc" && grows && choose_device(config.device).is_cpu()) {
    input_error(
        "--strategy mcmc --max_gaussians 0: expected a limit on a CPU, where free memory does not limit growth; ",
        "give one, such as --max_gaussians 1000000");
  }
  if (config.exposure && config.bilateral_grid) {
    input_error("--exposure and --bilateral_grid cannot be used together; the grid includes what an exposure does");
  }
  if (config.train_test_exp && !config.eval) {
    input_error("--train_test_exp: needs test views; add --eval, or leave it out");
  }
  if (!config.init_ply.empty()) holds_splats(config.init_ply);  // reads the header
}

Trainer::Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks) {
  check_scene_options(config, scene);
  set_compute_threads(config.threads);
  TrainConfig resolved = with_scene_limits(config, scene);
  resolved.device = device_name(choose_device(config.device));
  check_options(resolved);
  session_ = std::make_unique<Session>(resolved, scene, std::move(folder), std::move(hooks));
}
Trainer::~Trainer() = default;

std::vector<std::string> Trainer::resume(const std::filesystem::path& checkpoint) {
  return session_->resume(checkpoint);
}

TrainResult Trainer::run() {
  return session_->run_until(session_->iterations());
}

TrainResult Trainer::run_until(int iteration) {
  return session_->run_until(iteration);
}

int Trainer::iteration() const {
  return session_->state().iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  return session_->evaluate(views, on_rendered);
}

std::filesystem::path Trainer::write_checkpoint() {
  return session_->write_checkpoint();
}

std::filesystem::path Trainer::save() {
  return session_->save();
}

void Trainer::step() {
  session_->step();
}

void Trainer::wait() {
  session_->wait();
}

std::string Trainer::describe_images() const {
  return session_->describe_images();
}

std::int64_t Trainer::n_gaussians() const {
  return session_->state().n_gaussians();
}

int Trainer::sh_degree() const {
  return session_->state().sh_degree;
}

std::optional<MemoryForecast> Trainer::forecast_memory() {
  return session_->forecast_memory();
}

}  // namespace b3dgs
