#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/gaussian_grad.h"

namespace b3dgs::cpu {
namespace {

constexpr std::int64_t kGrain = 4096;

/// The rows of Gaussians that the view does not see.
void write_unseen(const SplatRecordArrays& out, std::int64_t n_gaussians) {
  parallel_chunks(n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.record_of_gaussian + begin, out.record_of_gaussian + end, -1);
    std::fill(out.means2d + 2 * begin, out.means2d + 2 * end, 0.0f);
  });
}

}  // namespace

void keep_splat_records(const SplatRecordArgs& args) {
  write_unseen(args.out, args.n_gaussians);
  parallel_chunks(args.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      const SplatGrad sum =
          sum_slots(args.pair_grads + args.slot_offsets[m], args.pair_grads + args.slot_offsets[m + 1]);
      keep_splat(args.out, m, args.splats[m].gaussian, sum, args.splats[m].clamped);
    }
  });
}

void sum_splat_grads(const SumSplatGradsArgs& args) {
  parallel_chunks(args.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      const SplatGrad* const pairs = args.pair_grads;
      args.out[m] = {sum_slots(pairs + args.slot_offsets[m], pairs + args.slot_offsets[m + 1]), {0, 0}};
    }
  });
}

void keep_splats(const KeepSplatsArgs& args) {
  write_unseen(args.out, args.n_gaussians);
  parallel_chunks(args.n_gaussians, kGrain,
                  [&](std::int64_t begin, std::int64_t end) { std::fill(args.radii + begin, args.radii + end, 0); });
  parallel_chunks(args.rows.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) keep_splat(args, m);
  });
}

}  // namespace b3dgs::cpu
