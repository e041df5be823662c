#!/usr/bin/env bash
# Runs the comparisons of docs/benchmarks.md on a GPU: each SCENE with everything that its report distinguishes,
# including the paper's comparison, and the synthetic street, whose photographs show Gaussians that training has to
# find. Writes OUTPUT/SCENE/report.html and compare.json, and prints their results.
# Usage: scripts/compare_scenes.sh B3DGS OUTPUT [SCENE...]
#   scripts/compare_scenes.sh build/gpu/app/b3dgs output/compared data/kitti_street data/bonsai data/fox
set -euo pipefail
cd "$(dirname "$0")/.."
b3dgs=${1:?the program is missing: scripts/compare_scenes.sh B3DGS OUTPUT [SCENE...]}
output=${2:?the output folder is missing: scripts/compare_scenes.sh B3DGS OUTPUT [SCENE...]}
shift 2

options=(--device cuda --noise --overwrite --quiet --preset inria)
for scene in "$@"; do
  echo "== $(basename "$scene")"
  time "$b3dgs" compare "$scene" -m "$output/$(basename "$scene")" "${options[@]}" \
    --configs naive,sub-tile,adaptive,paper \
    --iterations 5000 --test_iterations 5000
done

echo "== street"
if [[ ! -d $output/street_scene ]]; then "$b3dgs" synth street "$output/street_scene" --points 1500000 --quiet; fi
time "$b3dgs" compare "$output/street_scene" -m "$output/street" "${options[@]}" \
  --configs naive,sub-tile,adaptive,paper --iterations 3500 --test_iterations 3500
