#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/cpu/slot_sums.h"
#include "raster/math/projection.h"

namespace b3dgs::cpu {

void keep_splat_records(const SplatRecordArgs& args) {
  constexpr std::int64_t kGrain = 4096;
  const SplatRecordArrays& out = args.out;
  parallel_chunks(args.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.record_of_gaussian + begin, out.record_of_gaussian + end, -1);
    std::fill(out.means2d + 2 * begin, out.means2d + 2 * end, 0.0f);
  });
  parallel_chunks(args.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      const std::int32_t gaussian = args.splats[m].gaussian;
      const SplatGrad sum =
          sum_slots(args.pair_grads + args.slot_offsets[m], args.pair_grads + args.slot_offsets[m + 1]);
      out.records[m] = {sum, gaussian, args.splats[m].clamped};
      out.record_of_gaussian[gaussian] = static_cast<std::int32_t>(m);
      const Vec2f centre = centre_gradient(Vec2f{sum.q_x, sum.q_y});
      out.means2d[2 * std::int64_t{gaussian}] = centre.x;
      out.means2d[2 * std::int64_t{gaussian} + 1] = centre.y;
    }
  });
}

}  // namespace b3dgs::cpu
