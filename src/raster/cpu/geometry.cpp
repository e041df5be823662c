// Geometry pass: depth, normals and confidence of the surface that a view shows. The planes of the splats come first,
// then threads take tiles from an atomic counter. SIMD lanes are pixels, as in scoring (pair_sums.cpp).

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/geometry.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// Include after lanes-inl.h, because they compute on that SIMD type.
#include "raster/math/blend.h"
#include "raster/math/surface_blend.h"

#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/plane.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// A tile in the geometry pass. Padding pixels count as finished.
struct TileSurface : TileLayout {
  // As in SurfacePixel:
  HWY_ALIGN float transmittance[kCapacity], first[kCapacity], share[kCapacity], offset[kCapacity], square[kCapacity];
  HWY_ALIGN float variance[kCapacity], normal_x[kCapacity], normal_y[kCapacity], normal_z[kCapacity];

  HWY_INLINE TileSurface(const TileGrid& grid, std::int64_t tile) : TileLayout(grid, tile) {
    const int n = rows * stride;
    std::fill(transmittance, transmittance + n, kClosedPixel);
    for (float* plane : {first, share, offset, square, variance, normal_x, normal_y, normal_z}) {
      std::fill(plane, plane + n, 0.0f);
    }
    for (int row = 0; row < rows; ++row) {
      float* const t = transmittance + row * stride;
      std::fill(t, t + columns, 1.0f);
    }
  }

  bool is_finished() const {
    for (int p = 0; p < rows * stride; ++p) {
      if (transmittance[p] >= 0) return false;
    }
    return true;
  }

  HWY_INLINE SurfacePixel<Lanes> load(int p) const {
    return {Lanes::load(transmittance + p), Lanes::load(first + p),    Lanes::load(share + p),
            Lanes::load(offset + p),        Lanes::load(square + p),   Lanes::load(variance + p),
            Lanes::load(normal_x + p),      Lanes::load(normal_y + p), Lanes::load(normal_z + p)};
  }
  HWY_INLINE void store(const SurfacePixel<Lanes>& pixels, int p) {
    pixels.transmittance.store(transmittance + p);
    pixels.first.store(first + p);
    pixels.share.store(share + p);
    pixels.offset.store(offset + p);
    pixels.square.store(square + p);
    pixels.variance.store(variance + p);
    pixels.normal_x.store(normal_x + p);
    pixels.normal_y.store(normal_y + p);
    pixels.normal_z.store(normal_z + p);
  }

  /// Blends the splat onto the pixels of `row_span` and `vectors`.
  HWY_INLINE void blend(const Splat& splat, const PlaneRow& plane, DepthKind kind, const Span& row_span,
                        const Span& vectors) {
    const auto shape = splat_shape<Lanes>(splat);
    for (int row = row_span.begin; row < row_span.end; ++row) {
      const Lanes pixel_y = center_y(row);
      for (int v = vectors.begin; v < vectors.end; ++v) {
        const Lanes pixel_x = center_x(v * lane_count());
        const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, pixel_y);
        if (none(footprint.contributes)) continue;
        const int p = row * stride + v * lane_count();
        SurfacePixel<Lanes> pixels = load(p);
        blend_surface(pixels, kind, plane, footprint.contributes, evaluate_alpha(footprint.power).alpha,
                      pixel_x - shape.mean_x, pixel_y - shape.mean_y);
        store(pixels, p);
      }
    }
  }

  void finish(const GeometryArgs& args) const {
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        const int p = row * stride + column;
        store_surface(args, rect.x_begin + column, rect.y_begin + row,
                      {std::abs(transmittance[p]), first[p], share[p], offset[p], square[p], variance[p],
                       Vec3f{normal_x[p], normal_y[p], normal_z[p]}});
      }
    }
  }
};

}  // namespace

void run_geometry(const GeometryArgs& args, std::int64_t index) {
  constexpr std::int64_t kCheckInterval = 32;  // entries between tests whether all pixels are finished
  TileSurface tile(args.grid, index);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t i = first; i < last; ++i) {
    if ((i - first) % kCheckInterval == 0 && tile.is_finished()) break;
    const std::int32_t id = args.bins.splat_ids[i];
    const Splat& splat = args.splats[id];
    tile.blend(splat, args.planes[id], args.kind, tile.rows_reached(splat, args.extents[id], 0, tile.rows),
               tile.vectors_reached(splat, args.extents[id]));
  }
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_geometry);

namespace cpu {

void splat_planes(const PlaneArgs& args, std::int64_t n_splats, const Splat* splats, PlaneRow* out) {
  constexpr std::int64_t kGrain = 1024;  // splats per chunk
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  with_lens(args.view.lens, [&](const auto& lens) {
    parallel_each(n_splats, kGrain, [&](std::int64_t m) {
      const std::int64_t i = splats[m].gaussian;
      out[m] = args.antialiasing ? plane_row<true>(args.gaussians, i, view, lens, args.kind)
                                 : plane_row<false>(args.gaussians, i, view, lens, args.kind);
    });
  });
}

void geometry(const GeometryArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) { HWY_DYNAMIC_DISPATCH(run_geometry)(args, tile); });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
