#!/usr/bin/env bash
# Installs what is missing, builds, and runs all tests of this machine (CPU; tests that need a GPU say that they skip).
# Usage: scripts/test.sh [PRESET [CMAKE_OPTION...]]    presets: cpu (default), cpu-asan, cuda-compile
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-cpu}

scripts/install_packages.sh --tests
cmake --preset "$preset" -DB3DGS_TESTS=ON "${@:2}"
cmake --build --preset "$preset"
ctest --preset "$preset" --parallel 2
