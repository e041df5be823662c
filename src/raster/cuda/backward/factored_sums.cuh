// Turns the moments that a patch of pixels sums for a splat (backward_per_bucket.cu) into the splat's gradient, without
// cancellation along a needle (a long, thin splat).
#pragma once

#include "raster/args.h"

namespace b3dgs::cuda {

/// Sums of a patch for one entry, with q = dL/d(ln alpha) and (u, v) the pixel relative to the patch's centre. The
/// order matters, because store_sums() adds the first eight in halves (0 to 3 beside 4 to 7), and kDepth is only stored
/// with depth gradients.
enum PatchSum { kQ, kQu, kQv, kQuu, kRed, kGreen, kBlue, kQvv, kQuv, kDepth };
static_assert(kQvv == 7 && kQuv == 8 && kDepth == 9);

/// The stored conic factored as L D L^T, with L = (1 0; l 1) and D = diag(d1, d2). For delta = pixel - mean, p = conic
/// delta is then
///   (d1 a, l d1 a + d2 b)  with  a = delta_1 + l delta_2  and  b = delta_2.
/// Axis 1 is x or y, whichever has the larger diagonal element. Across a needle, p is a thousand times larger than
/// along it, but the gradient of the needle's length depends on the component along it. The factors keep the two
/// components apart. In sums of q p p^T from moments about the patch's centre, the smaller one would be lost by
/// cancellation.
struct FactoredConic {
  bool y_first;
  float d1, d2, l, l_low;  // l_low: the rounding error of l, xy / d1 - l
  __device__ explicit FactoredConic(const float4& conic) : y_first(conic.z > conic.x), d1(y_first ? conic.z : conic.x) {
    const float inverse = 1.0f / d1;
    l = conic.y * inverse;
    l_low = fmaf(-l, d1, conic.y) * inverse;
    d2 = fmaf(-l, conic.y, y_first ? conic.x : conic.z) - l_low * conic.y;
  }
};

/// Sums over the pixels of an entry, in the coordinates of FactoredConic.
struct FactoredSums {
  float q = 0, qa = 0, qb = 0, qaa = 0, qab = 0, qbb = 0, red = 0, green = 0, blue = 0, depth = 0;
};

/// x - y = high + low, exactly (Knuth).
struct Difference {
  float high, low;
  __device__ Difference(float x, float y) : high(x - y) {
    const float other = high - x;
    low = (x - (high - other)) - (y + other);
  }
};

/// Adds the sums of a patch, which are relative to its centre.
__device__ __forceinline__ void add_patch(FactoredSums& total, const float* sums, float2 center, const float4& mean,
                                          const FactoredConic& conic) {
  const Difference x(center.x, mean.x), y(center.y, mean.y);
  const float first = conic.y_first ? y.high : x.high, first_low = conic.y_first ? y.low : x.low;
  const float second = conic.y_first ? x.high : y.high, second_low = conic.y_first ? x.low : y.low;
  const float q = sums[kQ], q1 = sums[conic.y_first ? kQv : kQu], q2 = sums[conic.y_first ? kQu : kQv];
  const float q11 = sums[conic.y_first ? kQvv : kQuu], q22 = sums[conic.y_first ? kQuu : kQvv], q12 = sums[kQuv];
  // a and b at the centre, and moments of q in a and b about it.
  const float a = fmaf(conic.l, second, first) + (first_low + (conic.l * second_low + conic.l_low * second)),
              b = second;
  const float qa = q1 + conic.l * q2, qab = q12 + conic.l * q22;
  total.q += q;
  total.qa += a * q + qa;
  total.qb += b * q + q2;
  total.qaa += a * (a * q + 2 * qa) + (q11 + conic.l * (q12 + qab));
  total.qab += a * (b * q + q2) + (b * qa + qab);
  total.qbb += b * (b * q + 2 * q2) + q22;
  total.red += sums[kRed];
  total.green += sums[kGreen];
  total.blue += sums[kBlue];
}

__device__ __forceinline__ SplatGrad splat_grad(const FactoredSums& sums, const FactoredConic& conic) {
  const float first = conic.d1 * sums.qa, second = conic.l * first + conic.d2 * sums.qb;
  const float aa = conic.d1 * conic.d1 * sums.qaa, ab = conic.d1 * conic.d2 * sums.qab;
  const float cross = conic.l * aa + ab;
  const float second_second = conic.l * (cross + ab) + conic.d2 * conic.d2 * sums.qbb;
  return {sums.q,
          conic.y_first ? second : first,
          conic.y_first ? first : second,
          conic.y_first ? second_second : aa,
          cross,
          conic.y_first ? aa : second_second,
          sums.red,
          sums.green,
          sums.blue,
          sums.depth};
}

}  // namespace b3dgs::cuda
