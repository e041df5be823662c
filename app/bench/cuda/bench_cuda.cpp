// b3dgs bench on a GPU: median times of all kernels, measured with CUDA events. The image and the gradients of every
// kernel are compared with those of the first.
#include <cuda_runtime_api.h>

#include <cstdio>
#include <vector>

#include "app/bench/bench_devices.h"
#include "app/bench/cuda/bench_cuda_frame.h"
#include "core/check.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/gpu_support.h"

namespace b3dgs {
namespace {

using cuda::CudaFrame;
using cuda::EventTimer;

cudaDeviceProp device_properties() {
  int n_devices = 0;
  if (const cudaError_t code = cudaGetDeviceCount(&n_devices); code != cudaSuccess || n_devices == 0) {
    input_error("--device cuda: no usable GPU (", cudaGetErrorString(code), "); use --device cpu");
  }
  cuda::require_support(cuda::query_gpu_support());
  cudaDeviceProp properties{};
  B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, 0));
  return properties;
}

void check_tile(const BenchRun& run) {
  if (run.tile_width != 16 || (run.tile_height != 8 && run.tile_height != 16)) {
    input_error("tiles of ", run.tile_width, " x ", run.tile_height,
                " px are not supported on a GPU (expected 16x16 or 16x8)");
  }
}

const cuda::ForwardRow& row_of(ForwardKernel kernel) {
  return cuda::kForwardTable[static_cast<std::size_t>(kernel)];
}
const cuda::BackwardRow& row_of(BackwardKernel kernel) {
  return cuda::kBackwardTable[static_cast<std::size_t>(kernel)];
}

/// One view on the GPU and what is needed to time its passes.
struct Session {
  cuda::DriverMemory memory;
  cuda::LaunchContext context;
  CudaFrame frame;
  EventTimer timer;
  int repeat;

  Session(const BenchRun& run, const BenchScene& scene)
      : context(cuda::make_launch_context(nullptr, memory)),
        frame(run, scene, context),
        timer(context),
        repeat(run.repeat) {}

  /// Blending only, without storing what a backward pass needs.
  Timing time_forward(ForwardKernel kernel) {
    cuda::BlendForwardCudaArgs alone = frame.forward_args;
    alone.parts = {};
    return timer.time(
        repeat, [&] { frame.reset_pool(); }, [&] { row_of(kernel).launch(alone, context); });
  }

  /// Blending as in a training step, which also stores what each bucket of splats adds to each pixel.
  Timing time_keeping_forward(ForwardKernel kernel) {
    return timer.time(
        repeat, [&] { frame.reset_pool(); }, [&] { row_of(kernel).launch(frame.forward_args, context); });
  }

  Timing time_backward(BackwardKernel kernel) {
    return timer.time(
        repeat, [&] { frame.clear_splat_grads(); }, [&] { row_of(kernel).launch(frame.backward_args, context); });
  }

  /// Runs the forward pass that a backward pass needs.
  void run_forward(ForwardKernel kernel) {
    frame.poison_outputs();
    frame.reset_pool();
    row_of(kernel).launch(frame.forward_args, context);
    frame.backward_args.parts = cuda::parts_after(kernel, frame.forward_args);
  }

  std::vector<NamedArray> run_backward(BackwardKernel kernel) {
    frame.clear_splat_grads();
    row_of(kernel).launch(frame.backward_args, context);
    cuda::project_backward(frame.project_backward_args, context);
    return frame.gradients();
  }
};

void compare_forward(Session& session, BenchFile& file) {
  const TileShape tile = session.frame.forward_args.blend.grid.tile;
  ComparisonTable table("forward kernel", {/*image=*/true, /*gradients=*/true, /*resources=*/true, /*keeping=*/true});
  for (const ForwardKernelName& kernel : kForwardKernels) {
    const Timing timing = session.time_forward(kernel.kernel), keeping = session.time_keeping_forward(kernel.kernel);
    session.run_forward(kernel.kernel);
    std::vector<float> image = session.frame.image();
    table.add({std::string(kernel.name), timing, std::move(image), session.run_backward(BackwardKernel::kPerBucket),
               row_of(kernel.kernel).resources(tile), keeping});
    file.set("forward", table.rows());
  }
}

void compare_backward(Session& session, BenchFile& file) {
  const TileShape tile = session.frame.forward_args.blend.grid.tile;
  session.run_forward(ForwardKernel::kSharedMemory);
  ComparisonTable table("backward kernel", {/*image=*/false, /*gradients=*/true, /*resources=*/true});
  for (const BackwardKernelName& kernel : kBackwardKernels) {
    const Timing timing = session.time_backward(kernel.kernel);
    table.add({std::string(kernel.name),
               timing,
               {},
               session.run_backward(kernel.kernel),
               row_of(kernel.kernel).resources(tile)});
    file.set("backward", table.rows());
  }
}

void time_passes(Session& session, BenchFile& file) {
  CudaFrame& frame = session.frame;
  const cuda::LaunchContext& context = session.context;
  PassTable table("pass");
  const auto add = [&](const char* name, const std::function<void()>& prepare, const std::function<void()>& body) {
    table.add(name, session.timer.time(session.repeat, prepare, body));
  };
  const auto nothing = [] {};
  add("project", nothing, [&] { cuda::project(frame.project_args, context); });
  add("bin", nothing, [&] {
    cuda::number_lists(frame.bin_args.projected, frame.bin_args.grid.n_tiles(), frame.bin_buffers, context);
    cuda::bin(frame.bin_args, frame.bin_buffers, frame.bin_scratch, context);
  });
  table.add("blend forward", session.time_keeping_forward(ForwardKernel::kSharedMemory));
  table.add("blend backward", session.time_backward(BackwardKernel::kPerBucket));
  add("project backward", nothing, [&] { cuda::project_backward(frame.project_backward_args, context); });
  table.print_sum("forward+backward");
  file.set("passes", table.rows());
}

}  // namespace

bool has_gpu() {
  int n_devices = 0;
  const bool is_found = cudaGetDeviceCount(&n_devices) == cudaSuccess && n_devices > 0;
  if (!is_found) cudaGetLastError();  // clears the error
  return is_found;
}

void bench_kernels_cuda(const BenchRun& run, const BenchScene& scene, BenchFile& file) {
  check_tile(run);
  const cudaDeviceProp properties = device_properties();
  int driver = 0;
  B3DGS_CUDA_CHECK(cudaDriverGetVersion(&driver));
  Session session(run, scene);
  const nlohmann::ordered_json lists = session.frame.lists();
  std::printf("%lld visible Gaussians; %s, driver for CUDA %d.%d\n",
              static_cast<long long>(session.frame.found.n_splats), properties.name, driver / 1000, driver % 1000 / 10);
  print_list_statistics(lists);
  file.set("gpu", properties.name);
  file.set("cuda_driver", driver);
  file.set("lists", lists);
  file.set("n_splats", session.frame.found.n_splats);
  compare_forward(session, file);
  compare_backward(session, file);
  time_passes(session, file);
}

ForwardTimes time_forward_kernels_cuda(const BenchRun& run, const BenchScene& scene) {
  check_tile(run);
  ForwardTimes times;
  times.device = device_properties().name;
  Session session(run, scene);
  times.lists = session.frame.lists();
  for (const ForwardKernelName& kernel : kForwardKernels) {
    times.rows.push_back({std::string(kernel.name), session.time_forward(kernel.kernel)});
  }
  return times;
}

}  // namespace b3dgs
