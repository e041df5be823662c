// Applies deferred updates of SH coefficients, either to the visible Gaussians before their colours are computed, or to
// all Gaussians (flush). A block owns a range of Gaussians and lists those with work to do. One thread per listed
// Gaussian writes its gradients to a row of shared memory. Then the block processes all floats of these rows,
// coalesced, and replaces the gradients by the coefficients. Finally, one thread per Gaussian computes its colour.

#include "train/optimizer/deferred_sh.h"

#include "core/check.h"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/cuda/warp.cuh"
#include "train/optimizer/adam_step.cuh"
#include "train/optimizer/sh_decay.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kRows = 64;  // Gaussians per block; few, because its threads wait for one another

struct ApplyUpdatesArgs {
  ShRestArrays rests{};
  DeferredUpdate* updates = nullptr;  // [N]
  DeferredSteps steps{};
  ColorCudaArgs view{};  // only used if colours are computed
};

/// Compacted list of the rows of a block that have work to do, in shared memory.
struct RowList {
  int rows[kRows];
  int of_warp[kThreads / kWarpSize];  // number of rows listed by each warp
};

struct ListedRow {
  int place;   // index of the thread's row in the list, or -1
  int n_rows;  // length of the list
};

/// Builds the list of the rows whose threads pass true. All threads of the block call this. The list can be read after
/// the next barrier.
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

struct FirstStep {
  int n_applied;  // number of steps that are already applied
  float decay;
};

/// Writes the gradients of a Gaussian's first deferred step to `grads` [rest_floats(kShDegree)]. Not inlined, so that
/// all kernels compute the same bits.
template <int kShDegree>
__device__ __noinline__ FirstStep load_first_step(const DeferredUpdate* update, float* grads) {
  const float4 first = reinterpret_cast<const float4*>(update)[0];
  const float4 second = reinterpret_cast<const float4*>(update)[1];
  sh_rest_grad(kShDegree, Vec3f{second.x, second.y, second.z}, Vec3f{first.x, first.y, first.z}, grads);
  const bool has_gradient = first.x != 0 || first.y != 0 || first.z != 0;
  return {__float_as_int(first.w), has_gradient ? second.w : 0.0f};
}

/// Applies the deferred steps of the listed rows, for the degrees that are optimised so far. Coefficients of higher
/// degrees have zero moments, so a step does not change them. `rests` [n_rows, kActive] contains the gradients of the
/// first deferred step, which are replaced by the coefficients. `first_steps` has n_rows entries.
template <int kActive>
__device__ __forceinline__ void apply_updates(const ApplyUpdatesArgs& args, std::int64_t first_row, int n_rows,
                                              const int* rows, const FirstStep* first_steps, float* rests) {
  constexpr int kAtOnce = 8;  // loads in flight
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
      step[k] = first_steps[place / kActive].n_applied;
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
        const float shrink = args.steps.sizes[step[k]].step_size * first_steps[place / kActive].decay;
        param[k] = decayed(param[k], shrink, place % kActive / 3);
        do {
          step_one(args.steps.sizes[step[k]], grad, param[k], m[k], v[k], args.steps.rule);
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
__global__ void __launch_bounds__(kThreads) apply_updates_kernel(const __grid_constant__ ApplyUpdatesArgs args) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ RowList list;
  __shared__ FirstStep first_steps[kRows];
  __shared__ float rests[kRows * kActive];
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kRows, i = first_row + threadIdx.x;
  const bool is_listed =
      threadIdx.x < kRows && i < args.rests.n_gaussians && (!kColors || args.view.projected.radii[i] > 0);
  const ListedRow own = list_row(list, is_listed);
  if (is_listed) {
    first_steps[own.place] = load_first_step<kShDegree>(args.updates + i, rests + own.place * kActive);
    // The steps count as applied from here on, even if no backward pass follows.
    if (kColors) {
      *reinterpret_cast<float4*>(args.updates + i) = make_float4(0, 0, 0, __int_as_float(args.steps.n));
    }
  }
  __syncthreads();  // list and gradients are complete
  apply_updates<kActive>(args, first_row, own.n_rows, list.rows, first_steps, rests);
  __syncthreads();  // the coefficients are written
  if (kColors && is_listed) {
    const ColorCudaArgs& view = args.view;
    const float4 color = splat_color<kShDegree>(view.gaussians, view.camera_center, i, rests + own.place * kActive);
    if (!is_usable_color(color.x, color.y, color.z)) note_invalid(view.counts, i);
    reinterpret_cast<float4*>(view.projected.splats + i)[2] = color;
  }
}

}  // namespace

void DeferredSh::clear(std::int64_t n_gaussians, const LaunchContext& context) {
  const auto bytes = static_cast<std::size_t>(n_gaussians) * sizeof(DeferredUpdate);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(updates_.resize(n_gaussians, context), 0, bytes, context.stream));
}

template <bool kColors>
void DeferredSh::apply(const ColorCudaArgs& view, const LaunchContext& context) {
  if (rests_.n_gaussians == 0) return;
  const ApplyUpdatesArgs args{rests_, updates_.data(), steps_, view};
  const auto n_blocks = static_cast<unsigned>((rests_.n_gaussians + kRows - 1) / kRows);
  with_sh_degree<1>(sh_degree_, [&](auto degree) {  // there is nothing to defer at degree 0
    apply_updates_kernel<degree.value, kColors><<<n_blocks, kThreads, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

void DeferredSh::begin_view(const ShRestArrays& rests, int sh_degree, const LaunchContext& context) {
  if (steps_.n > 0 && (steps_.n == DeferredSteps::kMax || sh_degree != sh_degree_)) flush(rests, context);
  if (steps_.n > 0) {
    B3DGS_CHECK(rests == rests_, "begin_view() with other coefficients while updates are deferred");
    return;
  }
  sh_degree_ = sh_degree;
  if (rests == rests_) return;
  rests_ = {};  // invalid until clear() has allocated
  clear(rests.n_gaussians, context);
  rests_ = rests;
}

void DeferredSh::color(const ColorCudaArgs& args, const LaunchContext& context) {
  B3DGS_CHECK(args.gaussians.n_gaussians == rests_.n_gaussians && args.gaussians.shN == rests_.param &&
                  args.sh_degree == sh_degree_,
              "color() with other coefficients than begin_view()");
  apply<true>(args, context);
}

void DeferredSh::begin_step(int n_views, const LaunchContext& context) {
  if (n_views == n_views_) return;
  flush(rests_, context);
  n_views_ = n_views;
  steps_.rule = adam_rule(n_views);
}

void DeferredSh::defer_step(const AdamStepSize& size) {
  B3DGS_CHECK(steps_.n < DeferredSteps::kMax, "defer_step() without begin_view()");
  steps_.sizes[static_cast<std::size_t>(steps_.n++)] = size;
}

void DeferredSh::flush(const ShRestArrays& rests, const LaunchContext& context) {
  if (steps_.n == 0) return;
  B3DGS_CHECK(rests == rests_, "flush() with other coefficients than begin_view()");
  if (sh_degree_ > 0) {
    apply<false>({}, context);
    clear(rests_.n_gaussians, context);
  }
  steps_.n = 0;
}

}  // namespace b3dgs::cuda
