#include "raster/cuda/paper/paper.h"

#include <cuda_occupancy.h>

#include <algorithm>
#include <array>
#include <vector>

#include "core/cuda_check.h"

namespace b3dgs::cuda {
namespace {

PaperKernel find(ForwardKernel kernel) {
  const std::array kernels{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) &paper_##id,
      B3DGS_PAPER_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
  };
  const auto index = static_cast<std::size_t>(kernel);
  B3DGS_CHECK(index < kernels.size(), kernel_name(kernel), " is not a kernel of the paper");
  return kernels[index]();
}

const void* function_of(const PaperKernel& kernel) {
  return reinterpret_cast<const void*>(kernel.kernel);
}

std::int64_t n_blocks_of(const PaperKernel& kernel, const PaperArgs& args, const LaunchContext& context) {
  const std::int32_t n_patches = args.blend.grid.n_tiles();
  B3DGS_CHECK(n_patches < 1 << 24, "image too large for the paper's kernels: ", n_patches,
              " patches, expected below 2^24");
  if (!kernel.takes_tasks) return n_patches;
  int per_multiprocessor = 0;
  B3DGS_CUDA_CHECK(
      cudaOccupancyMaxActiveBlocksPerMultiprocessor(&per_multiprocessor, function_of(kernel), kPatchThreads, 0));
  return per_multiprocessor * context.n_multiprocessors;
}

/// Returns the fields that the CUDA occupancy calculator computes from the compiled kernel and the device.
KernelOccupancy calculate_occupancy(const PaperKernel& kernel) {
  int device = 0;
  cudaDeviceProp properties{};
  cudaFuncAttributes attributes{};
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, device));
  B3DGS_CUDA_CHECK(cudaFuncGetAttributes(&attributes, function_of(kernel)));
  const cudaOccDeviceProp of_device(properties);
  const cudaOccFuncAttributes of_kernel(attributes);
  const cudaOccDeviceState state{};
  cudaOccResult result{};
  const cudaOccError error =
      cudaOccMaxActiveBlocksPerMultiprocessor(&result, &of_device, &of_kernel, &state, kPatchThreads, 0);
  B3DGS_CHECK(error == CUDA_OCC_SUCCESS, "the occupancy calculator failed with ", static_cast<int>(error));
  KernelOccupancy occupancy;
  occupancy.registers = attributes.numRegs;
  occupancy.shared_bytes = static_cast<int>(attributes.sharedSizeBytes);
  occupancy.blocks = result.activeBlocksPerMultiprocessor;
  occupancy.theoretical =
      static_cast<double>(occupancy.blocks) * kPatchThreads / properties.maxThreadsPerMultiProcessor;
  const unsigned limits = result.limitingFactors;
  occupancy.limiter = (limits & OCC_LIMIT_WARPS) != 0           ? "warps"
                      : (limits & OCC_LIMIT_REGISTERS) != 0     ? "registers"
                      : (limits & OCC_LIMIT_SHARED_MEMORY) != 0 ? "shared memory"
                                                                : "blocks";
  return occupancy;
}

/// Returns the time in which at least one block of a multiprocessor ran. `runs` must be sorted by start.
unsigned long long active_cycles(const std::vector<BlockRun>& runs) {
  unsigned long long active = 0, until = 0;
  for (const BlockRun& run : runs) {
    if (run.end > until) active += run.end - std::max(run.start, until);
    until = std::max(until, run.end);
  }
  return active;
}

}  // namespace

void launch_paper(ForwardKernel kernel, const PaperArgs& args, const LaunchContext& context) {
  const PaperKernel found = find(kernel);
  const std::int64_t n_blocks = n_blocks_of(found, args, context);
  if (n_blocks == 0) return;
  if (found.takes_tasks) {
    B3DGS_CUDA_CHECK(cudaMemsetAsync(args.next_task, 0, sizeof(std::int32_t), context.stream));
  }
  PaperArgs passed = args;
  void* parameters[]{&passed};
  B3DGS_CUDA_CHECK(cudaLaunchKernel(function_of(found), static_cast<unsigned>(n_blocks), kPatchThreads, parameters, 0,
                                    context.stream));
}

KernelOccupancy measure_paper(ForwardKernel kernel, PaperArgs args, const LaunchContext& context) {
  const PaperKernel found = find(kernel);
  const std::int64_t n_blocks = n_blocks_of(found, args, context);
  KernelOccupancy occupancy = calculate_occupancy(found);
  DeviceBuffer<BlockRun> buffer;
  args.runs = buffer.resize(n_blocks, context);
  const std::size_t bytes = static_cast<std::size_t>(n_blocks) * sizeof(BlockRun);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.runs, 0, bytes, context.stream));
  launch_paper(kernel, args, context);
  std::vector<BlockRun> runs(static_cast<std::size_t>(n_blocks));
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(runs.data(), args.runs, bytes, cudaMemcpyDeviceToHost, context.stream));
  B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));

  std::sort(runs.begin(), runs.end(), [](const BlockRun& a, const BlockRun& b) { return a.start < b.start; });
  std::vector<std::vector<BlockRun>> by_multiprocessor(static_cast<std::size_t>(context.n_multiprocessors));
  double resident = 0, active = 0, longest = 0;  // cycles, summed over blocks or multiprocessors
  for (const BlockRun& run : runs) {
    by_multiprocessor.at(run.multiprocessor).push_back(run);
    resident += static_cast<double>(run.end - run.start);
  }
  for (const std::vector<BlockRun>& own : by_multiprocessor) {
    const auto cycles = static_cast<double>(active_cycles(own));
    active += cycles;
    longest = std::max(longest, cycles);
  }
  if (active == 0) return occupancy;
  const double most_blocks = occupancy.blocks / occupancy.theoretical;
  occupancy.achieved = resident / (active * most_blocks);
  occupancy.active = active / (longest * context.n_multiprocessors);
  return occupancy;
}

}  // namespace b3dgs::cuda
