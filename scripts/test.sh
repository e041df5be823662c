#!/usr/bin/env bash
# Installs missing packages, builds, and runs all tests of this machine (CPU; tests that need a GPU are skipped). Ends
# with a list of the skipped tests and the reasons.
# Usage: scripts/test.sh [PRESET [CMAKE_OPTION...]]    presets: cpu (default), cpu-asan, cuda-compile
# Environment: PARTS  with cpu-asan: builds and runs only these test programs, such as "core scene"
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-cpu}

scripts/install_packages.sh --tests
cmake --preset "$preset" -DB3DGS_TESTS=ON "${@:2}"
build=(cmake --build --preset "$preset" --parallel "$(nproc)")
test=(ctest --preset "$preset" --parallel 3)  # each may use all cores, and many wait for other processes or for time limits
if [[ -n ${PARTS:-} ]]; then
  read -ra parts <<<"$PARTS"
  build+=(--target "${parts[@]/%/_tests}")
  test+=(--no-tests=error -R "^($(IFS='|' && echo "${parts[*]}"))_tests")
fi
"${build[@]}"
status=0
"${test[@]}" || status=$?
scripts/list_skipped.sh "build/$preset"
exit "$status"
