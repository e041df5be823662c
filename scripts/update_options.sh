#!/usr/bin/env bash
# Writes docs/options.md from the option lists in the program: scripts/update_options.sh [BUILD_FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build/cpu}
cmake --build "$build" --target b3dgs
page=$(mktemp)
trap 'rm -f "$page"' EXIT
"$build/app/b3dgs" help-markdown > "$page"
cp "$page" docs/options.md
