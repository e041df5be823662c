// One view of a scene on a device, to time its passes.
#pragma once

#include <torch/types.h>

#include <functional>
#include <string>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "raster/kernels.h"
#include "raster/torch/rasterizer.h"
#include "train/timing/timers.h"

namespace b3dgs {

/// The loss is the mean of all colour values.
class BenchView {
 public:
  BenchView(const BenchRun& run, const BenchScene& scene);

  bool is_on_gpu() const { return device_.is_cuda(); }
  const torch::Device& device() const { return device_; }
  std::string device_text() const;

  /// Numbers of the view and of the kernel's lists in the last render().
  std::int64_t n_splats() const { return rasterizer_.view_size().n_splats; }
  nlohmann::ordered_json lists() const { return list_statistics(rasterizer_.count_load().tile_lists); }

  /// Runs a forward pass. With `keep`, it stores the data for a backward pass, as in a training step.
  void render(ForwardKernel kernel, bool keep);

  /// Times only the forward blend, on the lists of the last render(), which must have used a kernel of the same family.
  Timing time_blend(ForwardKernel kernel) {
    return time([&] { rasterizer_.reblend(kernel); });
  }
  /// Requires a GPU and a kernel of the paper.
  KernelOccupancy measure_occupancy(ForwardKernel kernel) { return rasterizer_.measure_occupancy(kernel); }

  Measurement measure(const KernelRow& kernel);
  /// Measures the backward kernel of a family, on a GPU.
  Measurement measure_backward(KernelFamily family);
  /// Returns the times of the passes of whole views, as in a training step.
  std::vector<StageTimes> run_passes();

 private:
  void flush_cache() {
    if (flush_.defined()) flush_.zero_();
  }
  /// One warm-up run, then the timed ones.
  Timing time(const std::function<void()>& run);
  std::vector<ParameterGradient> gradients();

  const torch::Device device_;
  const int repeat_;
  const CameraView view_;
  const GaussianTensors gaussians_;
  GaussianTensors gradients_;
  Rasterizer rasterizer_;
  RenderSettings settings_;
  RenderedView rendered_;
  RenderedViewGrad grad_;
  torch::Tensor flush_;
  StageClock clock_;
  StageTimer stages_;
};

}  // namespace b3dgs
