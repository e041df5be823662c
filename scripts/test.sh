#!/usr/bin/env bash
# Installs what is missing, builds, and runs all tests of this machine (CPU; tests that need a GPU say that they skip).
# Usage: scripts/test.sh [PRESET [CMAKE_OPTION...]]    presets: cpu (default), cpu-asan, cuda-compile
# Environment: PARTS  with cpu-asan: builds and runs only these test programs, such as "core scene"
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-cpu}

scripts/install_packages.sh --tests
cmake --preset "$preset" -DB3DGS_TESTS=ON "${@:2}"
build=(cmake --build --preset "$preset" --parallel "$(nproc)")
test=(ctest --preset "$preset" --parallel 2)
if [[ -n ${PARTS:-} ]]; then
  read -ra parts <<<"$PARTS"
  "${build[@]}" --target "${parts[@]/%/_tests}"
  "${test[@]}" --no-tests=error -R "^($(IFS='|' && echo "${parts[*]}"))_tests"
else
  "${build[@]}"
  "${test[@]}"
fi
