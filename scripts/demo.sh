#!/usr/bin/env bash
# From nothing to Gaussians on the CPU: installs what is missing, builds, writes a synthetic COLMAP scene, trains it,
# evaluates it, renders a flight, and says where the results are. Run it again at any time.
# Usage: scripts/demo.sh [OUTPUT_FOLDER]    default: output/demo in the repository
# The folder has to be new, empty, or that of an earlier demo, whose scene and model are replaced.
set -euo pipefail
out=$(realpath -m -- "${1:-$(dirname "$0")/../output/demo}")
cd "$(dirname "$0")/.."

mark=$out/.made_by_demo
if [[ -e $out && ! -f $mark ]] && ! { [[ -d $out ]] && [[ -z $(ls -A -- "$out") ]]; }; then
  echo "demo.sh: error: $out: holds something that the demo did not make; name another folder, or empty it" >&2
  exit 2
fi
mkdir -p -- "$out"
touch -- "$mark"

scripts/install_packages.sh
# A first build needs no test libraries; scripts/test.sh adds the tests to it.
tests=()
[[ -f build/cpu/CMakeCache.txt ]] || tests=(-DB3DGS_TESTS=OFF)
cmake --preset cpu "${tests[@]}"
cmake --build --preset cpu --target b3dgs
b3dgs=build/cpu/app/b3dgs

rm -rf -- "$out/scene" "$out/model"
"$b3dgs" synth orbit "$out/scene" --views 40 --width 320 --height 240
"$b3dgs" train -s "$out/scene" -m "$out/model" --eval --iterations 1500 --test_iterations 500 1000 1500 --device cpu
"$b3dgs" eval -m "$out/model" --save_images
"$b3dgs" render -m "$out/model" --path interpolated --frames 60

cat <<DONE

Done.
  Gaussians   $out/model/point_cloud/iteration_1500/point_cloud.ply   (opens in any 3DGS viewer)
  pictures    $out/model/test/ours_1500/{renders,gt,diff}/*.png
  flight      $out/model/interpolated/ours_1500/renders/*.png
  report      $out/model/report.html                                 (opens in any browser)
  measures    $out/model/results.json, per_view.json, train.jsonl
DONE
