#!/usr/bin/env bash
# Checks exports with the programs that read them: splat-transform (npm) reads our SPZ, and chromium shows the page that
# it writes. Installs both npm packages in build/npm (210 MB), which takes too long for a test. The tests in ctest skip
# if splat-transform is not in PATH. Exits with 77 if npm or its registry cannot be used.
# Usage: scripts/check_exports.sh [PRESET]    default: cpu, which has to be built with target app_tests
set -euo pipefail
cd "$(dirname "$0")/.."

build=build/${1:-cpu}
npm=$PWD/build/npm
program=$PWD/$build/app/b3dgs
if ! command -v npm >/dev/null; then
  echo "check_exports.sh: skipped, npm is not installed"
  exit 77
fi
mkdir -p "$npm"
if ! npm install --prefix "$npm" --no-save --no-audit --no-fund @playcanvas/splat-transform playwright-core \
  >"$npm/install.log" 2>&1; then
  echo "check_exports.sh: skipped, npm could not install @playcanvas/splat-transform ($npm/install.log)"
  exit 77
fi
export PATH=$npm/node_modules/.bin:$PATH
"$build/tests/app/app_tests" --gtest_filter='SplatTransform.*' --gtest_brief=1

if ! node -e 'process.exit(parseInt(process.versions.node) < 20 ? 1 : 0)'; then
  echo "check_exports.sh: the page is not opened, playwright-core needs node 20 or later"
  exit 0
fi
browser=$(command -v chromium || command -v chromium-browser || true)
if [[ -z $browser ]]; then
  echo "check_exports.sh: the page is not opened, chromium is not installed (scripts/install_packages.sh --tests)"
  exit 0
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$program" synth orbit "$work/scene" --points 2000 --views 9 --width 128 --height 96 --quiet
"$program" export "$work/scene/truth.ply" "$work/page.html" -s "$work/scene" --up auto
cat >"$npm/open_page.mjs" <<'END'
import { chromium } from 'playwright-core';
const [browserPath, file, picture] = process.argv.slice(2);
const args = ['--no-sandbox', '--disable-dev-shm-usage', '--enable-unsafe-swiftshader', '--use-gl=angle',
  '--use-angle=swiftshader', '--disable-background-networking', '--host-resolver-rules=MAP * ~NOTFOUND'];
const browser = await chromium.launch({ executablePath: browserPath, args });
const page = await browser.newPage({ viewport: { width: 400, height: 300 } });
const outside = [];
page.on('request', (request) => { if (!/^(file|data|blob):/.test(request.url())) outside.push(request.url()); });
await page.goto('file://' + file);
// The page while it loads takes 5 kB as PNG, a picture of Gaussians more than 30 kB.
let bytes = 0;
for (let i = 0; i < 30 && bytes < 15000; ++i) {
  await page.waitForTimeout(1000);
  bytes = (await page.screenshot({ path: picture })).length;
}
await browser.close();
if (outside.length > 0) throw new Error('the page asks for ' + outside[0]);
if (bytes < 15000) throw new Error('the page is blank, ' + bytes + ' bytes as PNG');
END
node "$npm/open_page.mjs" "$browser" "$work/page.html" "${B3DGS_SCREENSHOT:-$work/page.png}"
echo "check_exports.sh: splat-transform reads our SPZ, and the page shows the model without a network"
