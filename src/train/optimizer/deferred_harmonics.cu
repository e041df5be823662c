// Takes the steps that harmonics owe: of what a view sees, on the way to its colours, or of all Gaussians. A block owns
// a run of Gaussians and lists those that there is work for. A thread writes the gradients of each of these as a row of
// shared memory; then the block goes through all floats of these rows side by side, and leaves the harmonics in the
// gradients' place; then a thread finds the colour of each.

#include "train/optimizer/deferred_harmonics.h"

#include "core/check.h"
#include "raster/cuda/color.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/warp.cuh"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kRows = 64;  // Gaussians of a block: few, since its threads wait for one another

struct TakeStepsArgs {
  RestArrays rests{};
  OwedSteps* owed = nullptr;  // [N]
  StepSizes steps{};
  ColorCudaArgs view{};  // where colours are wanted
};

/// The rows of a block that there is work for, without gaps; in shared memory.
struct RowList {
  int rows[kRows];
  int of_warp[kThreads / kWarpSize];  // how many of each warp's
};

struct ListedRow {
  int place;   // of the thread's row in the list, or -1
  int n_rows;  // in the list
};

/// Lists the rows of threads that say so. For all threads of the block; the list can be read after its next barrier.
__device__ __forceinline__ ListedRow list_row(RowList& list, bool is_listed) {
  const auto thread = static_cast<int>(threadIdx.x), own_warp = thread / kWarpSize;
  const unsigned listed = __ballot_sync(kFullWarp, is_listed);
  if (lane_id() == 0) list.of_warp[own_warp] = __popc(listed);
  __syncthreads();  // all warps have counted
  ListedRow result{__popc(listed & ((1u << lane_id()) - 1)), 0};
#pragma unroll
  for (int warp = 0; warp < kThreads / kWarpSize; ++warp) {
    if (warp < own_warp) result.place += list.of_warp[warp];
    result.n_rows += list.of_warp[warp];
  }
  if (is_listed) {
    list.rows[result.place] = thread;
  } else {
    result.place = -1;
  }
  return result;
}

/// Gradients of the first step that a Gaussian owes, to `grads` [rest_floats(kShDegree)]. Returns the number of steps
/// taken so far. Not inlined, so that all kernels get the same bits.
template <int kShDegree>
__device__ __noinline__ int load_debt(const OwedSteps* owed, float* grads) {
  const float4 first = reinterpret_cast<const float4*>(owed)[0];
  const float4 second = reinterpret_cast<const float4*>(owed)[1];
  sh_rest_grad(kShDegree, Vec3f{second.x, second.y, second.z}, Vec3f{first.x, first.y, first.z}, grads);
  return __float_as_int(first.w);
}

/// Takes the steps that the listed rows of a block owe, of degrees that are learned by now: those above have never had
/// a gradient, their moments are 0, and a step would leave them alone. `rests` [n_rows, kActive] has the gradients of
/// the first of them and then the harmonics; `taken` [n_rows] says which steps are done.
template <int kActive>
__device__ __forceinline__ void take_steps(const TakeStepsArgs& args, std::int64_t first_row, int n_rows,
                                           const int* rows, const int* taken, float* rests) {
  constexpr int kAtOnce = 4;  // loads on their way
  const int n_rest = rest_floats(args.rests.sh_degree_max), n_floats = n_rows * kActive;
  float* const params = args.rests.param + first_row * n_rest;
  float* const ms = args.rests.m + first_row * n_rest;
  float* const vs = args.rests.v + first_row * n_rest;
  for (int start = static_cast<int>(threadIdx.x); start < n_floats; start += kAtOnce * kThreads) {
    int at[kAtOnce], step[kAtOnce];
    float param[kAtOnce], m[kAtOnce], v[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const int place = start + k * kThreads;
      if (place >= n_floats) break;
      at[k] = rows[place / kActive] * n_rest + place % kActive;
      step[k] = taken[place / kActive];
      param[k] = params[at[k]];
      m[k] = ms[at[k]];
      v[k] = vs[at[k]];
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const int place = start + k * kThreads;
      if (place >= n_floats) break;
      if (step[k] < args.steps.n) {
        float grad = rests[place];
        do {
          step_one(args.steps.sizes[step[k]], grad, param[k], m[k], v[k]);
          grad = 0;
        } while (++step[k] < args.steps.n);
        params[at[k]] = param[k];
        ms[at[k]] = m[k];
        vs[at[k]] = v[k];
      }
      rests[place] = param[k];
    }
  }
}

template <int kShDegree, bool kColors>
__global__ void __launch_bounds__(kThreads) take_steps_kernel(const __grid_constant__ TakeStepsArgs args) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ RowList list;
  __shared__ int taken[kRows];
  __shared__ float rests[kRows * kActive];
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kRows, i = first_row + threadIdx.x;
  const bool is_listed =
      threadIdx.x < kRows && i < args.rests.n_gaussians && (!kColors || args.view.projected.radii[i] > 0);
  const ListedRow own = list_row(list, is_listed);
  if (is_listed) {
    taken[own.place] = load_debt<kShDegree>(args.owed + i, rests + own.place * kActive);
    // Paid, even if no backward pass follows.
    if (kColors) {
      *reinterpret_cast<float4*>(args.owed + i) = make_float4(0, 0, 0, __int_as_float(args.steps.n));
    }
  }
  __syncthreads();  // list and gradients are complete
  take_steps<kActive>(args, first_row, own.n_rows, list.rows, taken, rests);
  __syncthreads();  // the harmonics are there
  if (kColors && is_listed) {
    const ColorCudaArgs& view = args.view;
    const float4 color = splat_color<kShDegree>(view.gaussians, view.camera_center, i, rests + own.place * kActive);
    if (!is_usable_color(color.x, color.y, color.z)) note_invalid(view.projected.counts, i);
    reinterpret_cast<float4*>(view.projected.splats + i)[2] = color;
  }
}

template <bool kColors>
void launch(const TakeStepsArgs& args, int sh_degree, const LaunchContext& context) {
  if (args.rests.n_gaussians == 0) return;
  const auto blocks = static_cast<unsigned>((args.rests.n_gaussians + kRows - 1) / kRows);
  with_sh_degree<1>(sh_degree, [&](auto degree) {  // there is nothing to defer at degree 0
    take_steps_kernel<degree.value, kColors><<<blocks, kThreads, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void DeferredHarmonics::clear(std::int64_t n_gaussians, const LaunchContext& context) {
  const auto bytes = static_cast<std::size_t>(n_gaussians) * sizeof(OwedSteps);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(owed_.resize(n_gaussians, context), 0, bytes, context.stream));
}

void DeferredHarmonics::begin_view(const RestArrays& rests, int sh_degree, const LaunchContext& context) {
  if (steps_.n > 0 && (steps_.n == StepSizes::kMax || sh_degree != sh_degree_)) settle(rests, context);
  if (steps_.n > 0) {
    B3DGS_CHECK(rests == rests_, "other harmonics while steps of the ones before are outstanding");
    return;
  }
  sh_degree_ = sh_degree;
  if (rests == rests_) return;
  rests_ = {};  // until there is room for what these will owe
  clear(rests.n_gaussians, context);
  rests_ = rests;
}

void DeferredHarmonics::color(const ColorCudaArgs& args, const LaunchContext& context) {
  B3DGS_CHECK(args.gaussians.n_gaussians == rests_.n_gaussians && args.gaussians.shN == rests_.param &&
                  args.sh_degree == sh_degree_,
              "a view of other harmonics than begin_view() was told");
  launch<true>({rests_, owed_.data(), steps_, args}, sh_degree_, context);
}

void DeferredHarmonics::put_off_step(const AdamStepSize& size) {
  B3DGS_CHECK(steps_.n < StepSizes::kMax, "steps put off without begin_view()");
  steps_.sizes[static_cast<std::size_t>(steps_.n++)] = size;
}

void DeferredHarmonics::settle(const RestArrays& rests, const LaunchContext& context) {
  if (steps_.n == 0) return;
  B3DGS_CHECK(rests == rests_, "other harmonics than those that steps were put off of");
  if (sh_degree_ > 0) {
    launch<false>({rests_, owed_.data(), steps_, {}}, sh_degree_, context);
    clear(rests_.n_gaussians, context);
  }
  steps_.n = 0;
}

}  // namespace b3dgs::cuda
