#!/usr/bin/env bash
# Makes docs/sample_report.html: the first 3000 iterations of a synthetic street from 4 million points, with adaptive and
# with fixed kernels on a GPU.
# Usage: scripts/sample_report.sh B3DGS [WORK_FOLDER [COMPARE_OPTIONS...]]    default: output/sample
#   scripts/sample_report.sh build/cuda/app/b3dgs output/sample --seeds 0 1
set -euo pipefail
cd "$(dirname "$0")/.."
b3dgs=${1:?the program is missing: scripts/sample_report.sh B3DGS [WORK_FOLDER [COMPARE_OPTIONS...]]}
work=${2:-output/sample}
shift $(($# < 2 ? $# : 2))

if [[ ! -d $work/street ]]; then "$b3dgs" synth street "$work/street" --points 4000000; fi
"$b3dgs" compare "$work/street" -m "$work/compare" --configs naive,adaptive,segmented,combined,shared-memory \
  --device cuda --iterations 3000 --stats_interval 250 --test_iterations 500 1000 2000 3000 \
  --overwrite "$@"

bytes=$(stat -c %s "$work/compare/report.html")
if ((bytes > 500000)); then
  echo "sample_report.sh: the report has $bytes bytes, too many to commit" >&2
  exit 1
fi
scripts/check_report.sh "$work/compare/report.html" || (($? == 77))
cp "$work/compare/report.html" docs/sample_report.html
echo "written: docs/sample_report.html, $bytes bytes"
