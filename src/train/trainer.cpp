#include "train/trainer.h"

#include <torch/cuda.h>

#include <chrono>

#include "model/formats/splat_formats.h"
#include "train/checkpoint/checkpoint.h"
#include "train/scene_limits.h"
#include "train/threads.h"
#include "train/trainer_impl.h"
#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_memory.h"
#endif

namespace b3dgs {

namespace {

double steady_clock_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void wait_for(torch::Device device) {
  if (device.is_cuda()) torch::cuda::synchronize();
}

KernelCheckTools kernel_check_tools(const TrainHooks& hooks) {
  KernelCheckTools tools;
  if (hooks.make_kernel_timer) tools.timer = hooks.make_kernel_timer();
  return tools;
}

/// --gpu_memory_gb of this rank. By default, ranks that share a GPU get equal parts of what is free there.
double gpu_memory_gb_of_rank(const TrainConfig& config, [[maybe_unused]] const torch::Device& device,
                             [[maybe_unused]] Communicator* ranks) {
#if B3DGS_TORCH_CUDA
  if (config.gpu_memory_gb == 0 && ranks != nullptr && ranks->shares_gpus()) {
    device_memory_size();  // makes the context of this process, which takes memory itself
    ranks->barrier("start of the GPU");
    const std::int64_t free = device_memory_size().free;
    ranks->barrier("free GPU memory");
    return 1e-9 * static_cast<double>(free) / ranks->n_on_own_gpu();
  }
#endif
  return config.gpu_memory_gb;
}

std::optional<DepthPriors> load_depths(const TrainConfig& config, const Scene& scene, const torch::Device& device,
                                       const ProgressFn& progress) {
  if (!uses_depths(config)) return std::nullopt;
  return DepthPriors(config.depths, scene, device, progress);
}

}  // namespace

Trainer::Impl::Impl(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks)
    : config(config),
      scene(scene),
      folder(std::move(folder)),
      hooks(std::move(hooks)),
      ranks(this->hooks.ranks),
      device(choose_device(config.device)),
      gpu_memory_gb(gpu_memory_gb_of_rank(config, device, ranks)),
      memory(this->hooks.memory ? this->hooks.memory : make_memory_source(device, gpu_memory_gb)),
      row_editor([this](auto sizes, const auto& options) { return memory->allocate(sizes, options); }),
      rasterizer(device),
      stepper(rasterizer),
      loss(device),
      appearance(make_appearance_model(config, static_cast<std::int64_t>(scene.train.size()), device)),
      depth_priors(load_depths(config, scene, device, this->hooks.on_loading)),
      density(make_density_strategy(config, scene.extent)),
      kernels(config, device, kernel_check_tools(this->hooks)),
      images(scene.train, device,
             this->hooks.image_budget ? *this->hooks.image_budget
                                      : image_budget(config.image_cache_gb, device, gpu_memory_gb),
             this->hooks.on_loading),
      reducer(device),
      timer(make_stage_clock(device)),
      time(this->hooks.clock_s ? this->hooks.clock_s : steady_clock_s, [where = device] { wait_for(where); }),
      poses(this->config, scene, state.poses),
      recorder({this->config, this->folder, this->hooks, state, time, *memory, timer, scene.frame},
               is_distributed() ? torch::Device(torch::kCPU) : device) {  // gathered rows are in host memory
  if (is_distributed()) splats.emplace(*ranks);
  if (config.antialiasing) {
    std::vector<PinholeView> views;
    for (const View& view : scene.train) views.push_back(to_pinhole_view(view.camera));
    smoothing_filter.emplace(views, static_cast<float>(config.near_plane), device);
  }
  if (depth_priors) {
    for (const std::string& warning : depth_priors->warnings()) recorder.warn(warning);
  }
  hold_images(scene.test, this->hooks.on_loading);  // in the host memory that the training views have left
  if (images.size() == 0) input_error(scene.source_path, ": no training views");
}

void check_options(const TrainConfig& config) {
  if (choose_device(config.device).is_cuda() && config.deterministic &&
      evaluation_settings(config, 0).backward_kernel != BackwardKernel::kPerSplat) {
    input_error("--deterministic: the backward kernel ", config.backward_kernel,
                " sums in an order that differs from run to run; use --backward_kernel per-splat");
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
  impl_ = std::make_unique<Impl>(resolved, scene, std::move(folder), std::move(hooks));
}
Trainer::~Trainer() = default;

std::vector<std::string> Trainer::resume(const std::filesystem::path& checkpoint) {
  Impl& impl = *impl_;
  Checkpoint read =
      read_checkpoint(checkpoint, impl.scene, impl.is_distributed() ? torch::Device(torch::kCPU) : impl.device);
  check_resume_options(read.config, read.state.iteration, impl.config, checkpoint.string());
  impl.fingerprint = impl.identify_scene();
  const nlohmann::ordered_json header = read_checkpoint_header(checkpoint);
  const auto warn_of = [&](const std::string& files, const std::vector<std::string>& changed) {
    if (changed.empty()) return;
    impl.recorder.warn(detail::concat(files, " have changed since this checkpoint was written (",
                                      changed.size() > 1 ? "first: " : "", changed.front(),
                                      "); training continues with the current files"));
  };
  const std::vector<std::string> photographs = changed_photographs(header, impl.fingerprint);
  warn_of(detail::concat(photographs.size(), " of ", impl.scene.train.size(), " photographs"), photographs);
  const std::vector<std::string> masks = changed_masks(header, impl.fingerprint);
  warn_of(detail::concat("masks of ", masks.size(), " of ", impl.scene.train.size(), " photographs"), masks);
  const std::vector<std::string> maps = changed_depth_maps(header, impl.fingerprint);
  warn_of(detail::concat("depth maps of ", maps.size(), " of ", impl.scene.train.size(), " photographs"), maps);
  if (have_points_changed(header, impl.fingerprint)) {
    impl.recorder.warn(
        "the points of the scene have changed since this checkpoint was written; training continues "
        "with its Gaussians");
  }
  impl.state = std::move(read.state);
  if (!impl.config.antialiasing) impl.state.gaussians.filters = torch::Tensor();
  if (impl.is_distributed()) impl.keep_own_rows();
  impl.prepare_appearance();
  // Another strategy may record something else: it starts a new round of statistics.
  if (read.config.strategy != impl.config.strategy) {
    impl.state.statistics = impl.density->make_statistics(impl.state.gaussians.size(), impl.device);
  }
  impl.resumed = checkpoint;
  impl.recorder.resume_from(checkpoint, impl.state.elapsed_s);
  impl.result.first_iteration = impl.state.iteration;
  impl.kernels.restore(impl.state.kernel_selection, checkpoint.string());
  std::error_code error;  // ignored: then the folders differ
  if (std::filesystem::equivalent(read.config.model_path, impl.config.model_path, error)) {
    read.config.model_path = impl.config.model_path;  // the same folder, named in another way
  }
  impl.changed_options = config_differences(read.config, impl.config);
  return impl.changed_options;
}

void Trainer::step() {
  Impl& impl = *impl_;
  if (impl.state.n_gaussians() == 0) impl.initialize_model();
  impl.time.train([&] { impl.step(); });
  impl.time.train([&] { impl.control_density(); });
  impl.recorder.collect_stage_times();
}

void Trainer::wait() {
  impl_->read_loss();
  impl_->recorder.wait_for_stage_times();
}

std::string Trainer::describe_images() const {
  return "for training " + describe(impl_->images.places()) + "; for testing " + describe(places_of(impl_->scene.test));
}

std::int64_t Trainer::n_gaussians() const {
  return impl_->state.n_gaussians();
}

int Trainer::sh_degree() const {
  return impl_->state.sh_degree;
}

TrainResult Trainer::run() {
  return run_until(impl_->config.iterations);
}

TrainResult Trainer::run_until(int iteration) {
  Impl& impl = *impl_;
  TrainResult& result = impl.result;
  B3DGS_CHECK(iteration <= impl.config.iterations, "iteration ", iteration, " of ", impl.config.iterations);
  impl.begin();
  while (impl.state.iteration < iteration && !result.interrupted) impl.iterate();
  if (impl.state.iteration == impl.config.iterations && impl.state.iteration > 0) impl.warn_of_empty_views();
  impl.time.finish_training();
  wait();
  impl.time.output([&] { impl.recorder.finish_files(); });
  static_cast<TrainOutputs&>(result) = impl.recorder.outputs();
  result.train_s = impl.time.train_s();
  result.output_s = impl.time.output_s();
  result.iteration = impl.state.iteration;
  result.n_gaussians = impl.state.n_gaussians();
  result.peak_memory_bytes = impl.memory->use().peak_reserved;
  result.n_removed = impl.state.n_removed;
  return result;
}

void Trainer::Impl::iterate() {
  try {
    time.train([&] { step(); });
    time.train([&] { recorder.report_progress("training"); });
    const OutputPlan plan = output_plan(config, first_of_step(), state.iteration, !scene.test.empty());
    const bool uses_device = plan.statistics || plan.kernel_times || plan.evaluate || plan.save;
    // Reading the loss waits for most of the step on a GPU.
    const bool ends = must_stop();
    if (plan.log || uses_device || plan.checkpoint || ends) time.train([&] { read_loss(); });
    if (uses_device || plan.checkpoint || ends) time.train([&] { flush(); });
    if (uses_device) {
      time.output([&] { write_outputs(plan); });
    } else if (plan.log) {
      // The device is still computing. Counting the line as output would mean waiting for the device, and would not
      // count the part of the step that runs meanwhile.
      time.train([&] { write_outputs(plan); });
    }
    if (state.iteration == config.iterations && (hooks.on_result || is_distributed())) {
      time.output([&] {
        on_first_rank([&] {
          if (hooks.on_result) recorder.try_to_write(hooks.on_result);
        });
      });
    }
    // If the last PLY could not be written, density control is left to the resumed training: it writes that PLY first.
    if (state.iteration < config.iterations || has_written_files()) time.train([&] { control_density(); });
    if (hooks.wants_model && !is_distributed() && hooks.wants_model()) show_model();
    result.interrupted = state.iteration < config.iterations && (is_distributed() ? ends : is_stopped());
    recorder.set_ending(result.interrupted);
    const bool is_due = is_distributed() ? agreed.write_checkpoint : recorder.is_checkpoint_due();
    if (plan.checkpoint || result.interrupted || is_due) time.output([&] { write_checkpoint(); });
    if (result.interrupted && !plan.save) time.output([&] { write_ply(); });
    // Of several ranks, none holds the whole model on its device.
    if (state.iteration == config.iterations && !is_distributed() && !is_stopped()) {
      time.output([&] { log_floaters(); });
    }
    if (hooks.wait_for_files) recorder.wait_for_files();
    recorder.collect_files();
  } catch (const LossError&) {
    throw;
  } catch (...) {
    end_with_checkpoint();
  }
}

void Trainer::Impl::show_model() {
  time.train([&] {
    read_loss();
    flush();
  });
  time.output([&] {
    const TrainState& whole = flushed_state();
    hooks.on_model({whole.iteration, whole.gaussians, whole.poses, whole.sh_degree, kernels.forward_name()});
  });
}

int Trainer::iteration() const {
  return impl_->state.iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  Impl& impl = *impl_;
  B3DGS_CHECK(impl.has_begun, "evaluate() before run_until()");
  if (impl.is_distributed()) {
    impl.poses.finish_step();
  } else {
    impl.read_loss();
  }
  const std::vector<View> refined = with_refined_poses(views, impl.scene.train, impl.state.poses);
  Evaluation evaluation;
  const auto evaluate = [&] {
    evaluation = impl.without_invalid_gaussians([&] {
      return evaluate_views([&](auto&&... view) { return impl.render(view...); }, impl.device, refined,
                            evaluation_settings(impl.config, impl.state.sh_degree), on_rendered, /*lpips=*/nullptr,
                            impl.color_evaluation());
    });
  };
  if (impl.renders_on_first) {
    evaluate();
  } else {
    impl.on_first_rank(evaluate);
  }
  return evaluation;
}

std::filesystem::path Trainer::write_checkpoint() {
  Impl& impl = *impl_;
  B3DGS_CHECK(impl.has_begun, "write_checkpoint() before run_until()");
  // Files that are still being written are those of a training that goes on.
  impl.recorder.wait_for_files();
  impl.recorder.collect_files();
  impl.recorder.set_ending(true);
  impl.write_checkpoint();
  impl.recorder.set_ending(false);
  const std::optional<WrittenFile> failed = impl.recorder.take_failed_checkpoint();
  if (failed) throw IoError(failed->error + impl.recorder.last_checkpoint());
  return impl.recorder.outputs().checkpoint;
}

std::filesystem::path Trainer::save() {
  Impl& impl = *impl_;
  std::filesystem::path checkpoint = write_checkpoint();
  if (!std::filesystem::exists(impl.folder.ply(impl.state.iteration))) {
    impl.recorder.set_ending(true);
    impl.write_ply();
    impl.recorder.set_ending(false);
  }
  return checkpoint;
}

}  // namespace b3dgs
