#include "train/training.h"

#include <torch/cuda.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "core/text.h"
#include "model/raster_input.h"
#include "raster/view_lens.h"
#include "scene/view_image.h"
#include "train/checkpoint/checkpoint.h"
#include "train/device.h"

namespace b3dgs {
namespace {

double steady_clock_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void wait_for(torch::Device device) {
  if (device.is_cuda()) torch::cuda::synchronize();
}

/// Returns the camera with the most pixels, combined with the lens that needs the most splats per Gaussian.
CameraView find_largest(const std::vector<CameraView>& views) {
  CameraView largest = *std::max_element(views.begin(), views.end(), [](const CameraView& a, const CameraView& b) {
    return std::int64_t{a.width} * a.height < std::int64_t{b.width} * b.height;
  });
  for (const CameraView& view : views) {
    if (splats_per_gaussian(view.lens) > splats_per_gaussian(largest.lens)) largest.lens = view.lens;
  }
  return largest;
}

double gpu_memory_gb(const TrainConfig& config, const TrainHooks& hooks) {
  return hooks.gpu_memory_gb.value_or(config.gpu_memory_gb);
}

}  // namespace

Training::Training(const FinalConfig& final_config, const Scene& of, ModelFolder into, TrainHooks with)
    : config(final_config.options),
      scene(of),
      folder(std::move(into)),
      hooks(std::move(with)),
      device(final_config.device),
      whole_device(hooks.make_team ? torch::Device(torch::kCPU) : device),
      memory(hooks.memory ? hooks.memory : make_memory_source(device, gpu_memory_gb(config, hooks))),
      rasterizer(device),
      optimizer(rasterizer, config.sh_decay),
      row_editor([this](auto sizes, const auto& options) { return memory->allocate(sizes, options); }),
      objective(config, scene, device, hooks.on_loading),
      density(make_density_strategy(config, scene.extent)),
      kernels(config, device_model(device), hooks.kernel_clock ? hooks.kernel_clock : make_stage_clock(device)),
      views(config, scene, state.poses, device,
            hooks.image_budget.value_or(image_budget(config.image_cache_gb, device, gpu_memory_gb(config, hooks))),
            hooks.on_loading),
      empty_views(scene.train),
      timer(make_stage_clock(device)),
      time(hooks.clock_s ? hooks.clock_s : steady_clock_s, [where = device] { wait_for(where); }),
      recorder({config, folder, hooks, state, time, *memory, timer, scene.frame}, whole_device) {
  for (const std::string& warning : objective.warnings()) recorder.warn(warning);
  if (!config.crop.empty()) density->set_region(in_frame(scene.frame, parse_crop(config.crop)));
  hold_images(scene.test, hooks.on_loading);  // in the host memory that the training views leave free
  if (views.size() == 0) input_error(scene.source_path, ": no training views");
  std::vector<CameraView> cameras;
  for (const View& view : scene.train) cameras.push_back(to_camera_view(view.camera));
  largest_view = find_largest(cameras);
  if (config.antialiasing) smoothing_filter.emplace(cameras, static_cast<float>(config.near_plane), device);
}

std::string Training::resume_words(const std::filesystem::path& checkpoint) const {
  const std::string& command = hooks.resume_command;
  return "continue with " + (command.empty() ? "--resume " + shell_quote(checkpoint.string()) : command);
}

std::string Training::last_checkpoint() const {
  if (!hooks.make_team) return recorder.last_checkpoint();
  const std::vector<int> iterations = folder.checkpoint_iterations();  // written by the first process
  if (iterations.empty()) return "; last checkpoint: none was written";
  const std::filesystem::path last = folder.checkpoint(iterations.back());
  return "; last checkpoint: " + last.string() + ", " + resume_words(last);
}

void Training::prepare_appearance() {
  const AppearanceModel* const appearance = objective.appearance();
  if (appearance == nullptr) {
    state.appearance = {};
  } else if (!appearance->fits(state.appearance)) {
    state.appearance = appearance->make_state();
  }
}

void Training::update_filters(bool is_due) {
  if (!smoothing_filter || state.n_gaussians() == 0) return;
  if (is_due || !state.gaussians.filters.defined()) {
    smoothing_filter->compute(state.gaussians, find_largest_filter);
  }
}

MemoryRemedy Training::waiting_for_files() {
  return [this] {
    if (!recorder.is_writing()) return false;
    recorder.wait_for_files();  // frees the copies on the device that the files are written from
    return true;
  };
}

MemoryRemedy Training::freeing_scratch() {
  return [this] {
    rasterizer.release_memory();
    memory->release_unused();
    return true;
  };
}

MemoryRemedy Training::releasing_photographs() {
  return [this] {
    // The next views may need as much as the model's largest tensor, which is about a quarter of the state.
    constexpr std::int64_t kAtLeast = std::int64_t{256} << 20;
    const std::int64_t freed = views.images.release_resident(std::max(kAtLeast, state_bytes(state) / 4));
    if (freed == 0) return false;
    memory->release_unused();
    recorder.say("fewer photographs stay on the GPU, because memory is short");
    return true;
  };
}

nlohmann::ordered_json scene_identity(const Training& training) {
  nlohmann::ordered_json identity = scene_fingerprint(training.scene);
  if (!training.objective.has_depths()) return identity;
  for (const std::filesystem::path& file : depth_map_files(training.config.depths, training.scene)) {
    identity["depth_maps"].push_back(photograph_fingerprint(file.string()));
  }
  return identity;
}

}  // namespace b3dgs
