#!/usr/bin/env bash
# Makes a sample report, WORK_FOLDER/model/report.html, and docs/images/report.png, a screenshot of it. The report is
# that of a short training on a synthetic scene on the CPU, which takes a few minutes. The screenshot needs chromium and
# pngquant.
# Usage: scripts/sample_report.sh B3DGS [WORK_FOLDER [TRAIN_OPTIONS...]]    default: output/sample
#   scripts/sample_report.sh build/cpu/app/b3dgs output/sample --seed 1
set -euo pipefail
cd "$(dirname "$0")/.."
usage="usage: scripts/sample_report.sh B3DGS [WORK_FOLDER [TRAIN_OPTIONS...]]"
b3dgs=${1:?missing argument: path of the b3dgs program; $usage}
work=${2:-output/sample}
shift $(($# < 2 ? $# : 2))
max_page_bytes=200000 max_picture_bytes=150000

# small FILE MAX_BYTES: fails if a file is too large.
small() {
  local bytes
  bytes=$(stat -c %s "$1")
  if ((bytes > $2)); then
    echo "sample_report.sh: $1 has $bytes bytes (expected at most $2)" >&2
    exit 1
  fi
}

mark=$work/.made_by_sample_report
if [[ -e $work/model && ! -f $mark ]]; then
  echo "sample_report.sh: error: $work/model was not made by this script; name another folder" >&2
  exit 2
fi
mkdir -p "$work"
touch "$mark"
scene=$work/orbit
if [[ ! -d $scene ]]; then
  "$b3dgs" synth orbit "$scene" --points 4000 --views 48 --width 240 --height 180 --quiet
fi
"$b3dgs" train "$scene" -m "$work/model" --eval --device cpu --preset inria --iterations 2000 --sh_increase_interval 500 \
  --densify_from_iter 300 --densify_until_iter 1600 --test_iterations 250 500 750 1000 1250 1500 1750 2000 \
  --overwrite --quiet "$@"

report=$work/model/report.html
small "$report" "$max_page_bytes"
scripts/check_report.sh "$report" || (($? == 77))
echo "written: $report"

browser=$(command -v chromium || command -v chromium-browser || true)
if [[ -z $browser || -z $(command -v pngquant) ]]; then
  echo "sample_report.sh: no screenshot, chromium or pngquant is not installed"
  exit 0
fi
mkdir -p docs/images
home=$(mktemp -d)
trap 'rm -rf "$home"' EXIT
HOME=$home "$browser" --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size=760,1340 \
  --screenshot="$work/screenshot.png" "file://$(realpath "$report")" >/dev/null 2>&1
pngquant --force --nofs --output "$work/report.png" 128 "$work/screenshot.png"
small "$work/report.png" "$max_picture_bytes"
cp "$work/report.png" docs/images/report.png
echo "written: docs/images/report.png"
