#!/usr/bin/env bash
# Runs clang-tidy over all C++ sources of the cpu preset, findings as errors.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset cpu >/dev/null
git ls-files -z 'src/*.cpp' 'app/*.cpp' 'data_synth/*.cpp' | xargs -0 -n 4 -P "$(nproc)" clang-tidy --quiet -p build/cpu
