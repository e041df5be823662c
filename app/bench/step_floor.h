// Lower bounds on the time of the stages of a training step on a GPU: computed from the bytes and instructions that a
// stage needs and from the rates of the GPU, never measured.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "raster/stages.h"

namespace b3dgs {

/// Properties of a GPU as the CUDA driver reports them.
struct GpuSpecs {
  std::string name;
  int n_multiprocessors = 0;
  double clock_khz = 0;         // of the multiprocessors, the highest
  double memory_clock_khz = 0;  // of the memory, which transfers twice per cycle
  int memory_bus_bits = 0;
};

/// The highest rates that a program can reach on a GPU.
struct GpuRates {
  double bytes_per_ms = 0;              // memory bandwidth
  double warp_instructions_per_ms = 0;  // all multiprocessors together
};

/// Assumes that programs reach at most 7/8 of the peak memory bandwidth and that a multiprocessor issues up to four
/// warp instructions per clock cycle, as all GPUs since Volta do. nullopt if the driver does not report a clock.
std::optional<GpuRates> reachable_rates(const GpuSpecs& gpu);

struct StepSize {
  std::int64_t n_gaussians = 0;
  int sh_degree = 3;    // of the rendered colours
  double n_pixels = 0;  // per view
};

/// Lower bound in ms; nullopt for stages that have none: kProjectBackward (counted in kOptimizer, as one kernel does
/// both), kUpload and kDensify. A bound is the sum of memory time and instruction time.
std::optional<double> step_floor_ms(Stage stage, const StepSize& size, const GpuRates& rates);

/// The assumptions behind the bounds, in a sentence for readers of the figures.
std::string step_floor_assumptions(const GpuSpecs& gpu, const GpuRates& rates);

}  // namespace b3dgs
