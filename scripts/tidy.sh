#!/usr/bin/env bash
# Runs clang-tidy (14, Debian 12's) on C++ sources. Findings are errors.
# Usage: scripts/tidy.sh [--without-torch] [FILE...]    default: all of src, app and data_synth
#   --without-torch  only sources that do not include LibTorch, whose headers take clang-tidy 20 s a file
set -euo pipefail
cd "$(dirname "$0")/.."

with_torch='.*'
if [[ ${1:-} == --without-torch ]]; then
  with_torch='^(src/(core|scene|model|adaptive)/|src/raster/cpu/|data_synth/|app/report/|app/compare/c(hance|ompar))'
  shift
fi
# clang cannot read headers that g++ precompiled, and needs a command for each source.
cmake --preset cpu -B build/tidy -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DCMAKE_UNITY_BUILD=OFF >/dev/null
files=("$@")
if ((${#files[@]} == 0)); then
  mapfile -t files < <(git ls-files 'src/*.cpp' 'app/*.cpp' 'data_synth/*.cpp' | grep -v '/cuda/' | grep -E "$with_torch")
fi
printf '%s\0' "${files[@]}" | xargs -0 -n 1 -P "$(nproc)" clang-tidy --quiet -p build/tidy \
  2> >(grep -v 'warnings generated' >&2)
echo "clang-tidy: ${#files[@]} files, no findings"
