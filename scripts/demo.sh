#!/usr/bin/env bash
# Runs everything on the CPU: installs missing packages, builds, writes a synthetic COLMAP scene, trains it, evaluates
# it, renders a flight, makes a picture, and prints where the results are and what to do next. It can be run again at
# any time.
# Usage: scripts/demo.sh [OUTPUT_FOLDER]    default: output/demo in the repository
# The folder has to be new, empty, or from an earlier demo, whose scene and model are replaced.
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

scripts/install_packages.sh ffmpeg
# A first build needs no test libraries; scripts/test.sh adds the tests to it.
tests=()
[[ -f build/cpu/CMakeCache.txt ]] || tests=(-DB3DGS_TESTS=OFF)
cmake --preset cpu "${tests[@]}"
cmake --build --preset cpu --target b3dgs
b3dgs=build/cpu/app/b3dgs

rm -rf -- "$out/scene" "$out/model"
"$b3dgs" synth orbit "$out/scene" --views 40 --width 320 --height 240
"$b3dgs" train -s "$out/scene" -m "$out/model" --eval --preset fast --iterations 1500 --test_iterations 500 1000 1500 --device cpu
"$b3dgs" eval -m "$out/model" --save_images
"$b3dgs" render -m "$out/model" --path test
"$b3dgs" render -m "$out/model" --path orbit --frames 90 --video "$out/flight.mp4" --overwrite

# A test view's photograph, its render and its depth, side by side. The view shows all solids.
views=$out/model/test/ours_1500
ffmpeg -nostdin -v error -y -i "$views/gt/00002.png" -i "$views/renders/00002.png" -i "$views/depth/00002.png" \
  -filter_complex '[0]pad=iw+8:color=white[a];[1]pad=iw+8:color=white[b];[a][b][2]hstack=3' "$out/demo.png"

cat <<DONE

Done.
  picture     $out/demo.png          (a photograph that was held out, its render, its depth)
  flight      $out/flight.mp4
  Gaussians   $out/model/point_cloud/iteration_1500/point_cloud.ply   (opens in any 3DGS viewer)
  images      $views/{renders,gt,diff,depth}/*.png
  measures    $out/model/results.json, per_view.json, train.jsonl

Next
  look at the model         $PWD/$b3dgs view $out/model
                            (prints an address; open it in your browser and drag)
  read the report           open $out/model/report.html in your browser
  use your own photographs  $PWD/$b3dgs reconstruct PHOTOS SCENE
                            (README.md, "Train on your photographs"; without COLMAP, it says how to get it)
DONE
