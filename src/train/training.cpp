#include "train/training.h"

#include <torch/cuda.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "core/text.h"
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

double gpu_memory_gb(const TrainConfig& config, const TrainHooks& hooks) {
  return hooks.gpu_memory_gb.value_or(config.gpu_memory_gb);
}

}  // namespace

Training::Training(const TrainConfig& options, const Scene& of, ModelFolder into, TrainHooks with)
    : config(options),
      scene(of),
      folder(std::move(into)),
      hooks(std::move(with)),
      device(choose_device(config.device)),
      memory(hooks.memory ? hooks.memory : make_memory_source(device, gpu_memory_gb(config, hooks))),
      rasterizer(device),
      objective(config, scene, device, hooks.on_loading),
      density(make_density_strategy(config, scene.extent)),
      kernels(config, device_model(device), hooks.kernel_clock ? hooks.kernel_clock : make_stage_clock(device)),
      views(config, scene, state.poses, device,
            hooks.image_budget.value_or(image_budget(config.image_cache_gb, device, gpu_memory_gb(config, hooks))),
            hooks.on_loading),
      timer(make_stage_clock(device)),
      time(hooks.clock_s ? hooks.clock_s : steady_clock_s, [where = device] { wait_for(where); }),
      // Several processes gather what they write in host memory.
      recorder({config, folder, hooks, state, time, *memory, timer, scene.frame},
               hooks.make_stepper ? torch::Device(torch::kCPU) : device) {
  for (const std::string& warning : objective.warnings()) recorder.warn(warning);
  hold_images(scene.test, hooks.on_loading);  // in the host memory that the training views have left
  if (views.size() == 0) input_error(scene.source_path, ": no training views");
}

std::string Training::resume_words(const std::filesystem::path& checkpoint) const {
  const std::string& command = hooks.resume_command;
  return "continue with " + (command.empty() ? "--resume " + shell_quote(checkpoint.string()) : command);
}

MemoryRemedy Training::wait_for_files() {
  return [this] {
    if (!recorder.is_writing()) return false;
    recorder.wait_for_files();  // frees the copies on the device that they are written from
    return true;
  };
}

MemoryRemedy Training::free_scratch() {
  return [this] {
    rasterizer.release_memory();
    memory->release_unused();
    return true;
  };
}

MemoryRemedy Training::release_photographs() {
  return [this] {
    // About the size of the model's largest tensor, since the next views may need that much again.
    constexpr std::int64_t kAtLeast = std::int64_t{256} << 20;
    const std::int64_t freed = views.images.release_resident(std::max(kAtLeast, state_bytes(state) / 4));
    if (freed == 0) return false;
    memory->release_unused();
    recorder.say("fewer photographs stay on the GPU: memory is short");
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
