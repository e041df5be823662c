#!/usr/bin/env bash
# Compares a configuration with itself on a machine with a changing load, and counts how often `b3dgs compare` reports a
# difference in time. Fails if more than one in twenty do. Also prints how many were too short to judge.
# Usage: scripts/compare_equal.sh [B3DGS [N_COMPARISONS [ITERATIONS]]]    default: build/cpu/app/b3dgs 20 1500
set -euo pipefail
b3dgs=$(realpath -- "${1:-$(dirname "$0")/../build/cpu/app/b3dgs}") n=${2:-20} iterations=${3:-1500}
work=$(mktemp -d)
pids=()
trap 'kill "${pids[@]}" 2>/dev/null || true; rm -rf -- "$work"' EXIT

"$b3dgs" synth orbit "$work/scene" --points 2000 --views 16 --width 160 --height 120 --quiet > "$work/log"
busy() {  # one core, for some seconds, again and again
  while true; do
    timeout $((RANDOM % 8 + 1)) bash -c 'while true; do :; done' || true
    sleep $((RANDOM % 6))
  done
}
for ((i = 0; i < $(nproc); ++i)); do
  busy &
  pids+=($!)
done

for ((i = 0; i < n; ++i)); do
  # The interval of checkpoints differs, which has no effect. Otherwise b would be a repetition that measures the noise.
  "$b3dgs" compare "$work/scene" -m "$work/compared" --overwrite --configs a:naive,b:naive+checkpoint_minutes=60 \
    --iterations "$iterations" --chunk 50 --seed "$i" --no_eval --device cpu --quiet > "$work/log" 2>&1 ||
    { cat "$work/log" >&2 && exit 1; }
  python3 - "$work/compared/compare.json" >> "$work/findings" << 'PYTHON'
import json, sys
saved = json.load(open(sys.argv[1]))["summary"]["compared"][0]["saved_overall"]
print("%s: time saved %.1f %%, may be chance below %.1f %%" % (saved["finding"], 100 * saved["mean"], 100 * saved["limit"]))
PYTHON
  tail -n 1 "$work/findings"
done
different=$(grep -c '^differs' "$work/findings" || true)
echo "$different of $n comparisons of equal configurations report a difference;" \
  "$(grep -c '^too short' "$work/findings" || true) were too short to judge"
((20 * different <= n))
