// Packs splats in the order of their Gaussians. Each Gaussian has none, one or, in a panorama, two.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/project_splat.h"

namespace b3dgs::cpu {

/// Contiguous splats of consecutive Gaussians.
struct PackedSplats {
  Splat* splats = nullptr;  // [n] in memory large enough for all
  Vec2f* extents = nullptr;
  std::int64_t n = 0, n_second = 0;
  std::int64_t invalid = -1;  // the first invalid Gaussian, after those that were added

  void add(const ProjectedGaussian& projected) {
    extents[n] = projected.extent;
    splats[n++] = projected.splat;
  }
  /// Adds the second splat of a Gaussian that crosses the seam of a panorama.
  void add_second(const ProjectArgs& args, const ProjectedGaussian& first) {
    const ProjectedGaussian second = across_the_seam(first, full_turn(args.view.fx), args.settings.culling, args.grid);
    if (second.outcome != Outcome::kSeen) return;
    ++n_second;
    if (args.is_drawn) add(second);
  }
};

/// Calls add_one(i, out) for each Gaussian. It adds the Gaussian's splats, at most n_each, and returns whether the
/// Gaussian is valid. Each chunk first packs its splats where all of them would fit, then the chunks are moved
/// together.
template <class AddOne>
PackedSplats pack_splats(std::int64_t n, std::int64_t n_each, const SplatRowArrays& room, AddOne&& add_one) {
  constexpr std::int64_t kGrain = 1024;  // Gaussians per chunk
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<PackedSplats> packed(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    const std::int64_t first = n_each * chunks.begin(chunk);
    PackedSplats own{room.splats + first, room.extents + first};
    for (std::int64_t i = chunks.begin(chunk), end = chunks.end(chunk); i < end && own.invalid < 0; ++i) {
      if (!add_one(i, own)) own.invalid = i;
    }
    packed[static_cast<std::size_t>(chunk)] = own;
  });
  PackedSplats all{room.splats, room.extents};
  for (const PackedSplats& own : packed) {
    if (own.splats != all.splats + all.n) {
      std::copy_n(own.splats, own.n, all.splats + all.n);
      std::copy_n(own.extents, own.n, all.extents + all.n);
    }
    all.n += own.n;
    all.n_second += own.n_second;
    all.invalid = own.invalid;
    if (all.invalid >= 0) break;
  }
  return all;
}

}  // namespace b3dgs::cpu
