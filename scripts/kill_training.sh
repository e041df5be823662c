#!/usr/bin/env bash
# Kills a small training at random moments, continues it with --resume auto, and checks that every folder is usable and
# that the last PLY is the same, byte for byte, as that of an uninterrupted training.
#
#   scripts/kill_training.sh [KILLS] [OPTIONS]
#     KILLS              how many (default: 1000)
#     --device cuda      on a GPU, with --deterministic (default: cpu)
#     --seed S           of the moments (default: 1)
#     --keep             keep the folders
#   BUILD_DIR            build folder (default: build/cpu, or build/gpu for cuda)
set -euo pipefail
cd "$(dirname "$0")/.."
if [[ ${1:-} == -h || ${1:-} == --help ]]; then
  sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
  exit 0
fi
kills=1000
if [[ ${1:-} =~ ^[0-9]+$ ]]; then
  kills=$1
  shift
fi
build=build/cpu
if [[ " $* " == *" cuda "* ]]; then build=build/gpu; fi
build=${BUILD_DIR:-$build}
if [[ ! -f $build/build.ninja ]]; then
  echo "kill_training.sh: $build holds no build; configure one (cmake --preset cpu) or set BUILD_DIR" >&2
  exit 2
fi
cmake --build "$build" --target kill_training >/dev/null
folder=$(mktemp -d)
time "$build/tests/app/kill_training" "$folder/kill_training" --kills "$kills" "$@"
if [[ " $* " != *" --keep "* ]]; then rmdir "$folder"; else echo "kept: $folder"; fi
