#!/usr/bin/env bash
# Uses the page of the live view in a browser: Chromium without a window, driven by playwright-core from npm. Keeps
# pictures in BUILD/view_pictures. Installs Chromium and, into BUILD/browser, playwright-core. If these are not
# available, prints that and does nothing.
# Usage: scripts/check_view.sh [BUILD]    (default build/cpu; the program must have been built there)
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build/cpu}

skip() {
  echo "check_view.sh: skipped: $1"
  exit 0
}

program=$build/app/b3dgs
if [[ ! -x $program ]]; then
  echo "check_view.sh: error: $program not found; build the target b3dgs first" >&2
  exit 2
fi
for tool in node npm; do
  command -v "$tool" >/dev/null || skip "no $tool"
done
node -e 'process.exit(parseInt(process.versions.node) < 20 ? 1 : 0)' || skip "playwright-core needs node 20 or later"
command -v chromium >/dev/null || scripts/install_packages.sh chromium || skip "no chromium"
if [[ ! -d $build/browser/node_modules/playwright-core ]]; then
  mkdir -p "$build/browser"
  npm install --silent --no-audit --no-fund --prefix "$build/browser" playwright-core@1 ||
    skip "no playwright-core from npm"
fi
mkdir -p "$build/view_pictures"
NODE_PATH=$PWD/$build/browser/node_modules node scripts/check_view.cjs "$program" "$build/view_pictures"
