// CUDA side of b3dgs bench: the paper's table on the GPU at hand. Events around each launch, the L2 cache flushed
// before it, medians; every alternative is checked against the first.
#include <cuda_runtime_api.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <vector>

#include "app/bench_devices.h"
#include "app/bench_report.h"
#include "check.h"
#include "raster/cuda/backward_table.h"
#include "raster/cuda/forward_table.h"
#include "raster/cuda/passes.h"
#include "raster/tiling.h"

namespace b3dgs {
namespace {

using cuda::DeviceBuffer;

class EventTimer {
 public:
  explicit EventTimer(const cuda::LaunchContext& context) : context_(context) {
    B3DGS_CUDA_CHECK(cudaEventCreate(&start_));
    B3DGS_CUDA_CHECK(cudaEventCreate(&stop_));
    flush_.resize(kFlushBytes, context);
  }
  ~EventTimer() {
    cudaEventDestroy(start_);
    cudaEventDestroy(stop_);
  }
  EventTimer(const EventTimer&) = delete;
  EventTimer& operator=(const EventTimer&) = delete;

  /// Two runs to warm up, then `repeat` timed ones; `prepare` runs before each, untimed.
  Timing time(int repeat, const std::function<void()>& prepare, const std::function<void()>& run) {
    std::vector<double> ms;
    for (int i = -2; i < repeat; ++i) {
      prepare();
      B3DGS_CUDA_CHECK(cudaMemsetAsync(flush_.data(), i & 1, kFlushBytes, context_.stream));
      B3DGS_CUDA_CHECK(cudaEventRecord(start_, context_.stream));
      run();
      B3DGS_CUDA_CHECK(cudaEventRecord(stop_, context_.stream));
      B3DGS_CUDA_CHECK(cudaEventSynchronize(stop_));
      float elapsed = 0;
      B3DGS_CUDA_CHECK(cudaEventElapsedTime(&elapsed, start_, stop_));
      if (i >= 0) ms.push_back(elapsed);
    }
    return summarize(std::move(ms));
  }

 private:
  static constexpr std::int64_t kFlushBytes = 256 << 20;  // several times the largest L2
  const cuda::LaunchContext& context_;
  cudaEvent_t start_{}, stop_{};
  DeviceBuffer<unsigned char> flush_;
};

/// Memory and arguments of one view on the device.
struct CudaFrame {
  const cuda::LaunchContext& context;
  const BenchConfig& config;
  std::int64_t n, n_pixels;
  DeviceBuffer<float> means, log_scales, quats, opacities, sh0, shN, color, depth, alpha, transmittance, grad_color;
  DeviceBuffer<float> out_means, out_log_scales, out_quats, out_opacities, out_sh0, out_shN, out_means2d;
  DeviceBuffer<Splat> splats;
  DeviceBuffer<Vec2f> extents;
  DeviceBuffer<std::int32_t> radii, n_tiles, last_ids, next_task;
  DeviceBuffer<cuda::ViewCounts> counts;
  DeviceBuffer<float4> state_light;
  DeviceBuffer<float> state_depth;
  DeviceBuffer<float2> bucket_ends;
  DeviceBuffer<std::uint32_t> quad_words;
  DeviceBuffer<cuda::SplatGradSum> splat_grads;
  cuda::BinBuffers bin_buffers;

  cuda::ProjectCudaArgs project{};
  cuda::ViewCounts found{};
  cuda::BinCudaArgs bin{};
  cuda::BinnedView binned{};
  cuda::BlendForwardCudaArgs forward{};
  cuda::BlendBackwardCudaArgs backward{};
  cuda::ProjectBackwardCudaArgs project_backward{};

  CudaFrame(const BenchConfig& bench_config, const BenchScene& scene, const cuda::LaunchContext& launch_context);

  const float* upload(DeviceBuffer<float>& buffer, const std::vector<float>& host) {
    float* const device = buffer.resize(static_cast<std::int64_t>(host.size()) + 1, context);
    B3DGS_CUDA_CHECK(
        cudaMemcpyAsync(device, host.data(), host.size() * sizeof(float), cudaMemcpyHostToDevice, context.stream));
    return device;
  }
  template <class T>
  std::vector<T> download(const T* device, std::int64_t count) const {
    std::vector<T> host(static_cast<std::size_t>(count));
    B3DGS_CUDA_CHECK(
        cudaMemcpyAsync(host.data(), device, host.size() * sizeof(T), cudaMemcpyDeviceToHost, context.stream));
    B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));
    return host;
  }
  void reset_pool() { B3DGS_CUDA_CHECK(cudaMemsetAsync(next_task.data(), 0, sizeof(std::int32_t), context.stream)); }
  void clear_splat_grads() {
    B3DGS_CUDA_CHECK(cudaMemsetAsync(
        splat_grads.data(), 0, static_cast<std::size_t>(found.n_splats) * sizeof(cuda::SplatGradSum), context.stream));
  }
};

CudaFrame::CudaFrame(const BenchConfig& bench_config, const BenchScene& scene,
                     const cuda::LaunchContext& launch_context)
    : context(launch_context),
      config(bench_config),
      n(scene.cloud.size()),
      n_pixels(std::int64_t{scene.view.width} * scene.view.height) {
  const SplatCloud& cloud = scene.cloud;
  const GaussianArrays arrays{n,
                              cloud.sh_degree,
                              upload(means, cloud.means),
                              upload(log_scales, cloud.log_scales),
                              upload(quats, cloud.quats),
                              upload(opacities, cloud.logit_opacities),
                              upload(sh0, cloud.sh0),
                              upload(shN, cloud.shN)};
  const Culling culling = config.culling == "square" ? Culling::kSquare : Culling::kEllipse;
  const TileGrid grid = make_tile_grid(scene.view.width, scene.view.height, {config.tile_width, config.tile_height});
  const cuda::ProjectOutputs outputs{splats.resize(n, context), extents.resize(n, context), radii.resize(n, context),
                                     n_tiles.resize(n, context), counts.resize(1, context)};
  project = {arrays, scene.view, cloud.sh_degree, kNearPlane, culling, grid, outputs};
  cuda::project(project, context);
  found = download(outputs.counts, 1).front();
  bin = {outputs, n, found.n_splats, found.n_isects, grid, culling};
  binned = cuda::bin(bin, bin_buffers, context);

  const std::int64_t n_states = binned.buckets.n_max * (std::int64_t{grid.tile.width} * grid.tile.height);
  const ImageArrays image{color.resize(3 * n_pixels, context), depth.resize(n_pixels, context),
                          alpha.resize(n_pixels, context)};
  const cuda::BucketParts parts{state_light.resize(n_states, context), state_depth.resize(n_states, context)};
  forward = {{binned.splats, binned.extents, binned.bins, grid, Vec3f{0, 0, 0}, image,
              transmittance.resize(n_pixels, context), last_ids.resize(n_pixels, context)},
             binned.buckets,
             parts,
             next_task.resize(1, context),
             quad_words.resize(n_states / 4, context)};
  const std::vector<float> uniform(static_cast<std::size_t>(3 * n_pixels), 1.0f / static_cast<float>(3 * n_pixels));
  const ImageGradArrays grad{upload(grad_color, uniform), nullptr, nullptr};
  backward = {{binned.splats, binned.extents, binned.bins, grid, Vec3f{0, 0, 0}, image, transmittance.data(),
               last_ids.data(), grad, nullptr},
              binned.buckets,
              parts,
              bucket_ends.resize(n_states, context),
              splat_grads.resize(found.n_splats, context)};
  const GaussianGradArrays out{
      out_means.resize(3 * n, context),  out_log_scales.resize(3 * n, context),
      out_quats.resize(4 * n, context),  out_opacities.resize(n, context),
      out_sh0.resize(3 * n, context),    out_shN.resize(static_cast<std::int64_t>(cloud.shN.size()) + 1, context),
      out_means2d.resize(2 * n, context)};
  project_backward = {
      arrays, scene.view, cloud.sh_degree, outputs.radii, binned.rank_of_gaussian, binned.splats, splat_grads.data(),
      out};
}

nlohmann::ordered_json bench_forward(CudaFrame& frame, EventTimer& timer) {
  ComparisonTable table("forward kernel");
  // As the paper's table: the blend alone, without what a training step keeps for its backward pass.
  cuda::BlendForwardCudaArgs alone = frame.forward;
  alone.parts = {};
  for (const ForwardKernelName& kernel : kForwardKernels) {
    const auto launch = cuda::kForwardTable[static_cast<std::size_t>(kernel.kernel)];
    const Timing timing = timer.time(
        frame.config.repeat, [&] { frame.reset_pool(); }, [&] { launch(alone, frame.context); });
    table.add(std::string(kernel.name), timing, frame.download(frame.forward.blend.out.color, 3 * frame.n_pixels));
  }
  return table.rows();
}

nlohmann::ordered_json bench_backward(CudaFrame& frame, EventTimer& timer) {
  frame.reset_pool();
  cuda::launch_forward_shared_memory(frame.forward, frame.context);
  ComparisonTable table("backward kernel");
  for (const BackwardKernelName& kernel : kBackwardKernels) {
    const auto launch = cuda::kBackwardTable[static_cast<std::size_t>(kernel.kernel)];
    const Timing timing = timer.time(
        frame.config.repeat, [&] { frame.clear_splat_grads(); }, [&] { launch(frame.backward, frame.context); });
    cuda::project_backward(frame.project_backward, frame.context);
    std::vector<float> gradient = frame.download(frame.out_means.data(), 3 * frame.n);
    double largest = 0;
    for (const float value : gradient) largest = std::max(largest, std::fabs(double{value}));
    if (largest > 0) {
      for (float& value : gradient) value = static_cast<float>(value / largest);  // shown relative to the largest
    }
    table.add(std::string(kernel.name), timing, gradient);
  }
  return table.rows();
}

nlohmann::ordered_json bench_passes(CudaFrame& frame, EventTimer& timer) {
  PassTable table("pass");
  const auto nothing = [] {};
  const auto add = [&](const char* name, const std::function<void()>& prepare, const std::function<void()>& run) {
    table.add(name, timer.time(frame.config.repeat, prepare, run));
  };
  add("project", nothing, [&] { cuda::project(frame.project, frame.context); });
  add("bin", nothing, [&] { cuda::bin(frame.bin, frame.bin_buffers, frame.context); });
  add(
      "blend forward", [&] { frame.reset_pool(); },
      [&] { cuda::launch_forward_shared_memory(frame.forward, frame.context); });
  add(
      "blend backward", [&] { frame.clear_splat_grads(); },
      [&] { cuda::launch_backward_per_splat(frame.backward, frame.context); });
  add("project backward", nothing, [&] { cuda::project_backward(frame.project_backward, frame.context); });
  table.print_sum("forward+backward");
  return table.rows();
}

}  // namespace

nlohmann::ordered_json bench_cuda(const BenchConfig& config, const BenchScene& scene) {
  int n_devices = 0;
  if (const cudaError_t code = cudaGetDeviceCount(&n_devices); code != cudaSuccess || n_devices == 0) {
    input_error("--device cuda: no GPU can be used (", cudaGetErrorString(code), "); use --device cpu");
  }
  cudaDeviceProp properties{};
  B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, 0));
  int driver = 0;
  B3DGS_CUDA_CHECK(cudaDriverGetVersion(&driver));

  cuda::DriverMemory memory;
  const cuda::LaunchContext context = cuda::make_launch_context(nullptr, memory);
  CudaFrame frame(config, scene, context);
  const std::int32_t n_tiles = frame.forward.blend.grid.n_tiles();
  const std::vector<std::int64_t> offsets = frame.download(frame.binned.bins.tile_offsets, n_tiles + 1);
  std::vector<long long> lengths;
  for (std::size_t tile = 0; tile + 1 < offsets.size(); ++tile) lengths.push_back(offsets[tile + 1] - offsets[tile]);
  const nlohmann::ordered_json lists = list_statistics(std::move(lengths));
  std::printf("%lld seen; %s, CUDA %d.%d of the driver\n", static_cast<long long>(frame.found.n_splats),
              properties.name, driver / 1000, driver % 1000 / 10);
  print_list_statistics(lists);

  EventTimer timer(context);
  nlohmann::ordered_json report;
  report["forward"] = bench_forward(frame, timer);
  report["backward"] = bench_backward(frame, timer);
  report["passes"] = bench_passes(frame, timer);
  report["lists"] = lists;
  report["n_splats"] = frame.found.n_splats;
  report["gpu"] = properties.name;
  report["cuda_driver"] = driver;
  return report;
}

}  // namespace b3dgs
