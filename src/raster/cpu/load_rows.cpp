// Views split at the splats: what takes the place of projection where they are drawn. Not in project_cpu.cpp, so that
// the compiler goes on inlining all of projection there.

#include <algorithm>
#include <cstdint>

#include "core/parallel.h"
#include "raster/cpu/pack_splats.h"
#include "raster/cpu/passes.h"

namespace b3dgs::cpu {

std::int64_t load_rows(const SplatRows& rows, const ProjectArgs& args) {
  const auto load = [&](std::int64_t m) {
    args.radii[m] = rows.radii[m];
    Splat splat = rows.splats[m];
    splat.gaussian = static_cast<std::int32_t>(m);
    return splat;
  };
  if (splats_per_gaussian(args.view.lens) == 2) {
    const auto add_one = [&](std::int64_t m, PackedSplats& out) {
      ProjectedGaussian first;
      first.radius = rows.radii[m];
      first.extent = rows.extents[m];
      first.splat = load(m);
      out.add(first);
      add_second(args, first, out);
      return true;
    };
    return pack_splats(rows.n_splats, 2, args, add_one).n;
  }
  constexpr std::int64_t kGrain = 1024;
  parallel_chunks(rows.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::copy(rows.extents + begin, rows.extents + end, args.extents + begin);
    for (std::int64_t m = begin; m < end; ++m) args.splats[m] = load(m);
  });
  return rows.n_splats;
}

}  // namespace b3dgs::cpu
