#!/usr/bin/env bash
# Writes docs/options.md from the option lists in the program: scripts/update_options.sh [BUILD_FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build/cpu}
if [[ ! -f $build/CMakeCache.txt ]]; then
  echo "update_options.sh: error: not a build folder: $build (scripts/test.sh makes build/cpu)" >&2
  exit 2
fi
cmake --build "$build" --target b3dgs
page=$(mktemp)
trap 'rm -f "$page"' EXIT
"$build/app/b3dgs" help-markdown > "$page"
cp "$page" docs/options.md
