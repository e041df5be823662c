#!/usr/bin/env bash
# Runs clang-tidy (14, Debian 12's) over C++ sources, findings as errors.
# Usage: scripts/tidy.sh [FILE...]    default: all of src, app and data_synth
set -euo pipefail
cd "$(dirname "$0")/.."
# clang does not read the headers that g++ precompiles.
cmake --preset cpu -B build/tidy -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >/dev/null
if (($# == 0)); then mapfile -t files < <(git ls-files 'src/*.cpp' 'app/*.cpp' 'data_synth/*.cpp' | grep -v cuda/); else files=("$@"); fi
printf '%s\0' "${files[@]}" | xargs -0 -n 1 -P "$(nproc)" clang-tidy --quiet -p build/tidy 2> >(grep -v 'warnings generated' >&2)
echo "clang-tidy: ${#files[@]} files, no findings"
