// Passes over splats other than projection and blending. A thread per row (a Gaussian or a splat) unless noted.
//
//   copy_seen                 for views rendered elsewhere: copies each splat from its Gaussian's row after projection
//   copy_second_colors        for panoramas: copies the colours of a Gaussian's first splat to its second
//   join_second               for panoramas: adds the sums of a Gaussian's second splat to those of its first
//   invert_depths             for inverse depth (math/project_splat.h), and its gradients
//   sum_splat_grads           for deterministic gradients: sums those of each splat's pairs in a fixed order. A warp
//                             per splat: lanes take the pairs in turn, and shuffles sum the lanes
//   keep_splat_records        stores sums for a later backward projection; keep_splats: for splats rendered elsewhere

#include "raster/cuda/launch.cuh"
#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/gaussian_grad.h"
#include "raster/math/project_splat.h"

namespace b3dgs::cuda {
namespace {

constexpr int kGradWords = sizeof(SplatGradSum) / sizeof(float4);

__device__ __forceinline__ void add(float4& sum, float4 value) {
  sum = make_float4(sum.x + value.x, sum.y + value.y, sum.z + value.z, sum.w + value.w);
}

__device__ __forceinline__ void join(SplatGradSum& first, const SplatGradSum& second) {
  auto* const words = reinterpret_cast<float4*>(&first);
  for (int k = 0; k < kGradWords; ++k) add(words[k], reinterpret_cast<const float4*>(&second)[k]);
}
__device__ __forceinline__ void join(ScoreSums& first, const ScoreSums& second) {
  first.error += second.error;
  first.weight += second.weight;
  first.max_weight = fmaxf(first.max_weight, second.max_weight);
}

}  // namespace

void copy_seen(const ProjectOutputs& projected, const std::int32_t* seen, std::int64_t capacity,
               const SplatRowArrays& out, const LaunchContext& context) {
  each_row(capacity, context, [=] __device__(std::int64_t m) {
    if (m >= projected.counts->n_splats) return;
    const std::int32_t i = seen[m];
    out.splats[m] = projected.splats[i];
    out.extents[m] = projected.extents[i];
    out.radii[m] = projected.radii[i];
  });
}

void copy_second_colors(const ProjectOutputs& projected, std::int64_t n_gaussians, const LaunchContext& context) {
  each_row(n_gaussians, context, [=] __device__(std::int64_t i) {
    if (projected.radii[n_gaussians + i] == 0) return;
    auto* const words = reinterpret_cast<float4*>(projected.splats + n_gaussians + i);
    words[2] = reinterpret_cast<const float4*>(projected.splats + i)[2];
  });
}

template <class Sums>
void join_second(std::int64_t n_gaussians, const std::int32_t* radii, Sums* sums, const LaunchContext& context) {
  each_row(n_gaussians, context, [=] __device__(std::int64_t i) {
    if (radii[n_gaussians + i] > 0) join(sums[i], sums[n_gaussians + i]);
  });
}
template void join_second(std::int64_t, const std::int32_t*, SplatGradSum*, const LaunchContext&);
template void join_second(std::int64_t, const std::int32_t*, ScoreSums*, const LaunchContext&);

void invert_depths(std::int64_t n_rows, const std::int32_t* radii, Splat* splats, const LaunchContext& context) {
  each_row(n_rows, context, [=] __device__(std::int64_t i) {
    if (radii[i] > 0) invert_depth(splats[i]);
  });
}

void invert_depth_gradients(std::int64_t n_rows, const std::int32_t* radii, const Splat* splats, SplatGradSum* sums,
                            const LaunchContext& context) {
  each_row(n_rows, context, [=] __device__(std::int64_t i) {
    if (radii[i] > 0) sums[i].sum.depth = depth_gradient(splats[i], sums[i].sum.depth);
  });
}

void sum_splat_grads(std::int64_t n_rows, const std::int64_t* slot_offsets, const SplatGradSum* pair_grads,
                     SplatGradSum* sums, const LaunchContext& context) {
  each_row(n_rows * kWarpSize, context, [=] __device__(std::int64_t thread) {
    const std::int64_t splat = thread / kWarpSize;
    float4 sum[kGradWords]{};
    for (std::int64_t slot = slot_offsets[splat] + lane_id(); slot < slot_offsets[splat + 1]; slot += kWarpSize) {
      const auto* const words = reinterpret_cast<const float4*>(pair_grads + slot);
      for (int k = 0; k < kGradWords; ++k) add(sum[k], words[k]);
    }
    auto* const out = reinterpret_cast<float4*>(sums + splat);
#pragma unroll
    for (int k = 0; k < kGradWords; ++k) {
      const float4 whole = make_float4(warp_sum(sum[k].x), warp_sum(sum[k].y), warp_sum(sum[k].z), warp_sum(sum[k].w));
      if (lane_id() == 0) out[k] = whole;
    }
  });
}

void keep_splat_records(const ProjectBackwardCudaArgs& args, std::int32_t* n_records, const SplatRecordArrays& out,
                        const LaunchContext& context) {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(n_records, 0, sizeof(std::int32_t), context.stream));
  each_row(args.gaussians.n_gaussians, context,
           [=, radii = args.radii, splats = args.splats, sums = args.splat_grads] __device__(std::int64_t i) {
             if (radii[i] > 0) {
               keep_splat(out, atomicAdd(n_records, 1), static_cast<std::int32_t>(i), sums[i].sum, splats[i].clamped);
             } else {
               out.record_of_gaussian[i] = -1;
               reinterpret_cast<float2*>(out.means2d)[i] = make_float2(0, 0);
             }
           });
}

void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context) {
  const auto fill = [&](void* rows, int value, std::size_t row_bytes) {
    const std::size_t bytes = static_cast<std::size_t>(args.n_gaussians) * row_bytes;
    B3DGS_CUDA_CHECK(cudaMemsetAsync(rows, value, bytes, context.stream));
  };
  fill(args.out.record_of_gaussian, 0xff, sizeof(std::int32_t));  // -1
  fill(args.out.means2d, 0, 2 * sizeof(float));
  fill(args.radii, 0, sizeof(std::int32_t));
  each_row(args.rows.n_splats, context, [=] __device__(std::int64_t m) { keep_splat(args, m); });
}

}  // namespace b3dgs::cuda
