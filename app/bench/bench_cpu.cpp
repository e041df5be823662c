// b3dgs bench on the CPU: forward kernels and the passes of one view.
#include <chrono>
#include <cstdio>
#include <functional>
#include <vector>

#include "app/bench/bench_devices.h"
#include "app/bench/bench_report.h"
#include "core/check.h"
#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs {
namespace {

/// One warm-up run, then `repeat` timed ones.
Timing time_runs(int repeat, const std::function<void()>& body) {
  using Clock = std::chrono::steady_clock;
  body();
  std::vector<double> ms;
  for (int i = 0; i < repeat; ++i) {
    const Clock::time_point start = Clock::now();
    body();
    ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - start).count());
  }
  return summarize(std::move(ms));
}

/// Buffers and arguments for one view. They are public, so that each pass can be run alone.
struct BenchFrame {
  cpu::Buffer<Splat> splats;
  cpu::Buffer<Vec2f> extents;
  std::vector<std::int32_t> radii, last_ids;
  std::vector<float> color, depth, alpha, transmittance;
  cpu::BinBuffers bin_buffers;

  ProjectArgs project{};
  std::int64_t n_splats = 0;
  BinArgs bin{};
  BinnedSplats bins{};
  BlendForwardArgs forward{};

  BenchFrame(const BenchRun& run, const BenchScene& scene);
};

BenchFrame::BenchFrame(const BenchRun& run, const BenchScene& scene) {
  const auto n = static_cast<std::size_t>(scene.cloud.size());
  const std::size_t n_pixels = static_cast<std::size_t>(scene.view.width) * static_cast<std::size_t>(scene.view.height);
  splats.resize(scene.cloud.size());
  extents.resize(scene.cloud.size());
  radii.resize(n);
  color.resize(3 * n_pixels);
  depth.resize(n_pixels);
  alpha.resize(n_pixels);
  transmittance.resize(n_pixels);
  last_ids.resize(n_pixels);

  const Culling culling = run.culling == "square" ? Culling::kSquare : Culling::kEllipse;
  const TileGrid grid = make_tile_grid(scene.view.width, scene.view.height, {run.tile_width, run.tile_height});
  project = {scene.arrays(), scene.view,    scene.cloud.sh_degree, kNearPlane,  culling,
             grid,           splats.data(), extents.data(),        radii.data()};
  n_splats = cpu::project(project);
  bin = {splats.data(), extents.data(), radii.data(), n_splats, grid, culling};
  bins = cpu::bin(bin, bin_buffers);
  forward = {
      splats.data(),        extents.data(), bins, grid, Vec3f{0, 0, 0}, {color.data(), depth.data(), alpha.data()},
      transmittance.data(), last_ids.data()};
}

Timing time_forward(const BenchRun& run, const BenchFrame& frame, ForwardKernel kernel) {
  return time_runs(run.repeat, [&] { cpu::blend_forward(kernel, frame.forward); });
}

void compare_kernels(const BenchRun& run, BenchFrame& frame, BenchFile& file) {
  ComparisonTable table("forward kernel", {});
  for (const ForwardKernelName& kernel : kForwardKernels) {
    const Timing timing = time_forward(run, frame, kernel.kernel);
    table.add({std::string(kernel.name), timing, frame.color, {}});
    file.set("kernels", table.rows());
  }
}

void time_passes(const BenchRun& run, const BenchScene& scene, BenchFrame& frame, BenchFile& file) {
  const auto n = static_cast<std::size_t>(scene.cloud.size());
  const std::vector<float> grad_color(frame.color.size(), 1.0f / static_cast<float>(frame.color.size()));
  cpu::Buffer<SplatGrad> pair_grads;
  pair_grads.resize(frame.bins.n_pairs);
  std::vector<float> means(3 * n), log_scales(3 * n), quats(4 * n), opacities(n), sh0(3 * n),
      shN(scene.cloud.shN.size()), means2d(2 * n);
  cpu::blend_forward(ForwardKernel::kSharedMemory, frame.forward);
  const BlendForwardArgs& f = frame.forward;
  const BlendBackwardArgs backward{f.splats,         f.extents,    f.bins,
                                   f.grid,           f.background, f.out,
                                   f.transmittance,  f.last_ids,   {grad_color.data(), nullptr, nullptr},
                                   pair_grads.data()};
  const GaussianGradArrays grads{means.data(), log_scales.data(), quats.data(),  opacities.data(),
                                 sh0.data(),   shN.data(),        means2d.data()};
  const ProjectBackwardArgs project_backward{
      frame.project.gaussians, frame.project.view,      frame.project.sh_degree, f.splats,
      frame.n_splats,          frame.bins.slot_offsets, pair_grads.data(),       grads};

  PassTable table("pass");
  const auto add = [&](const char* name, const std::function<void()>& body) {
    table.add(name, time_runs(run.repeat, body));
    file.set("passes", table.rows());
  };
  add("project", [&] { cpu::project(frame.project); });
  add("bin", [&] { cpu::bin(frame.bin, frame.bin_buffers); });
  add("blend forward", [&] { cpu::blend_forward(ForwardKernel::kSharedMemory, frame.forward); });
  add("blend backward", [&] { cpu::blend_backward(backward); });
  add("project backward", [&] { cpu::project_backward(project_backward); });
  table.print_sum("forward+backward");
}

nlohmann::ordered_json statistics_of_lists(const BenchFrame& frame) {
  std::vector<std::int64_t> lengths;
  for (std::int32_t tile = 0; tile < frame.forward.grid.n_tiles(); ++tile) {
    lengths.push_back(frame.bins.tile_offsets[tile + 1] - frame.bins.tile_offsets[tile]);
  }
  return list_statistics(lengths);
}

}  // namespace

void bench_kernels_cpu(const BenchRun& run, const BenchScene& scene, BenchFile& file) {
  BenchFrame frame(run, scene);
  const nlohmann::ordered_json lists = statistics_of_lists(frame);
  std::printf("%lld visible Gaussians; CPU, %d threads\n", static_cast<long long>(frame.n_splats), thread_count());
  print_list_statistics(lists);
  file.set("lists", lists);
  file.set("n_splats", frame.n_splats);
  file.set("threads", thread_count());
  compare_kernels(run, frame, file);
  time_passes(run, scene, frame, file);
}

ForwardTimes time_forward_kernels_cpu(const BenchRun& run, const BenchScene& scene) {
  const BenchFrame frame(run, scene);
  ForwardTimes times{detail::concat("CPU, ", thread_count(), " threads"), statistics_of_lists(frame), {}};
  for (const ForwardKernelName& kernel : kForwardKernels) {
    times.rows.push_back({std::string(kernel.name), time_forward(run, frame, kernel.kernel)});
  }
  return times;
}

}  // namespace b3dgs
