// One view on the GPU for the benchmarks. The arguments of each pass are public, so that any pass can be run alone and
// repeatedly.
#pragma once

#include <cuda_runtime_api.h>

#include <array>
#include <functional>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/passes.h"
#include "raster/kernels.h"

namespace b3dgs::cuda {

/// Times runs with CUDA events and flushes the L2 cache before each.
class EventTimer {
 public:
  explicit EventTimer(const LaunchContext& context);
  ~EventTimer();
  EventTimer(const EventTimer&) = delete;
  EventTimer& operator=(const EventTimer&) = delete;

  /// Two warm-up runs, then `repeat` timed ones. `prepare` runs before each and is not timed.
  Timing time(int repeat, const std::function<void()>& prepare, const std::function<void()>& body);

 private:
  static constexpr std::int64_t kFlushBytes = 256 << 20;  // several times the largest L2
  const LaunchContext& context_;
  cudaEvent_t start_{}, stop_{};
  DeviceBuffer<unsigned char> flush_;
};

/// Buffers and arguments for one view. The loss is the mean of all colour values.
class CudaFrame {
 public:
  /// Runs projection and binning.
  CudaFrame(const BenchRun& run, const BenchScene& scene, const LaunchContext& context);

  ProjectCudaArgs project_args{};
  ViewCounts found{};
  BinCudaArgs bin_args{};
  BinnedView binned{};
  BinBuffers bin_buffers;
  PassScratch bin_scratch;
  BlendForwardCudaArgs forward_args{};
  BlendBackwardCudaArgs backward_args{};
  ProjectBackwardCudaArgs project_backward_args{};

  /// Fills the outputs of the forward pass with NaN, so that a kernel that does not write a value is noticed.
  void poison_outputs();
  /// Call before each run of a forward kernel.
  void reset_pool();
  /// Call before each run of a backward kernel.
  void clear_splat_grads();

  // Copies to the host; these wait for the GPU.
  std::vector<float> image() const;           // [H, W, 3]
  std::vector<NamedArray> gradients() const;  // one array per parameter
  nlohmann::ordered_json lists() const;       // list_statistics()

 private:
  GaussianArrays upload_gaussians(const SplatCloud& cloud);
  void set_up_blending(const TileGrid& grid);
  const float* upload(DeviceBuffer<float>& buffer, const std::vector<float>& host);
  template <class T>
  std::vector<T> download(const T* device, std::int64_t count) const;

  const LaunchContext& context_;
  std::int64_t n_, n_pixels_, n_parts_ = 0, n_rest_;
  DeviceBuffer<float> means_, log_scales_, quats_, opacities_, sh0_, shN_;
  DeviceBuffer<float> color_, depth_, alpha_, transmittance_, grad_color_;
  DeviceBuffer<float> grad_means_, grad_log_scales_, grad_quats_, grad_opacities_, grad_sh0_, grad_shN_, grad_means2d_;
  DeviceBuffer<Splat> splats_;
  DeviceBuffer<Vec2f> extents_;
  DeviceBuffer<std::int32_t> radii_, list_growth_, last_ids_;
  DeviceBuffer<ViewCounts> counts_;
  DeviceBuffer<float4> part_light_;
  ForwardScratch scratch_;
  std::array<PassScratch, kForwardKernels.size()>
      kernel_scratch_;  // separate, since the arguments of all kernels are prepared together
  DeviceBuffer<SplatGradSum> splat_grads_;
};

}  // namespace b3dgs::cuda
