#!/usr/bin/env bash
# Installs the libraries into a temporary folder, moves that folder, builds docs/library_example against it and trains a
# synthetic scene: scripts/test_library.sh [BUILD_FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build/cpu}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cmake --install "$build" --component development --prefix "$work/installed" > "$work/log"
mv "$work/installed" "$work/moved"
if grep -rlF "$PWD" "$work/moved/lib" --include='*.cmake'; then
  echo "test_library.sh: error: these files of the package name the source folder" >&2
  exit 1
fi
prefix=$(sed -n 's/^CMAKE_PREFIX_PATH:[A-Z]*=//p' "$build/CMakeCache.txt")
cmake -S docs/library_example -B "$work/build" -DCMAKE_PREFIX_PATH="$work/moved;$prefix" > "$work/log" ||
  { cat "$work/log"; exit 1; }
cmake --build "$work/build" > "$work/log" || { cat "$work/log"; exit 1; }

"$build/app/b3dgs" synth orbit "$work/scene" --views 6 --width 64 --height 48 --points 300 --quiet
"$work/build/train_scene" "$work/scene" "$work/model"
ply=$work/model/point_cloud/iteration_100/point_cloud.ply
[[ -s $ply ]] || { echo "test_library.sh: error: no $ply" >&2; exit 1; }
if "$work/build/train_scene" "$work/nothing" "$work/other" 2> "$work/error"; then
  echo "test_library.sh: error: a missing scene was accepted" >&2
  exit 1
fi
grep -q "^error: scene folder not found" "$work/error"
echo "test_library.sh: the example was built against the installed package, and trained a model"
