#!/usr/bin/env bash
# From nothing to Gaussians on the CPU: installs what is missing, builds, writes a synthetic COLMAP scene, trains it,
# evaluates it, renders a flight, and says where the results are. Run it again at any time.
# Usage: scripts/demo.sh [OUTPUT_FOLDER]    default: output/demo
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-output/demo}

scripts/install_packages.sh
cmake --preset cpu -DB3DGS_TESTS=OFF -B build/demo
cmake --build build/demo --target b3dgs
b3dgs=build/demo/app/b3dgs

rm -rf "$out"
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
