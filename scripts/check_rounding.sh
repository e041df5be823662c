#!/usr/bin/env bash
# Several kernels determine the tiles of a splat and must compute the same bits (src/raster/math/tiling.h). Fails if the
# PTX of one of them has a sum or a product there that the compiler could contract, or has contracted. Needs nvcc, but
# no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH=$PATH:/usr/local/cuda/bin

ptx=$(mktemp)
trap 'rm -f "$ptx"' EXIT
failed=0
for source in project bin; do
  nvcc -std=c++17 -O3 --extended-lambda -lineinfo -arch=compute_80 -Isrc -ptx "src/raster/cuda/$source.cu" -o "$ptx"
  # The first pass finds the numbers of the two headers, the second the float operations that come from their lines.
  awk -v source="$source.cu" '
    FNR == NR { if ($1 == ".file" && $3 ~ /\/(tiling|strict_float)\.h"/) is_strict[$2] = 1; next }
    $1 == ".loc" { file = $2 }
    /[ \t]mul\.f32[ \t].*, 0f[0-9A-F][0-9A-F][08]00000;/ { next }  # by a power of two: exact
    file in is_strict && /[ \t](add|sub|mul|fma|mad|div|sqrt)[.a-z]*\.f32[ \t]/ {
      if ($0 ~ /[ \t](add|sub|mul|div|sqrt)\.rn\.f32[ \t]/) ++n_strict; else { print source ": " $0; ++n_loose }
    }
    END {
      printf "%s: %d float operations of tiling.h, %d of them not rounded by themselves\n", source, n_strict + n_loose, n_loose
      exit n_loose > 0 || n_strict == 0
    }' "$ptx" "$ptx" || failed=1
done
exit "$failed"
