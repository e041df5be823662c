#!/usr/bin/env bash
# Measures with Nsight Compute how the blend kernels use the GPU: theoretical and achieved occupancy, and the share of
# the time in which a multiprocessor has any work (which is low for an unbalanced launch). Profiles one launch of each
# kernel of `b3dgs bench kernels`, with caches flushed before it and unchanged clocks.
#
#   scripts/profile_kernels.sh [BENCH_ARGUMENT ...]
#   scripts/profile_kernels.sh street --points 1500000
#   B3DGS                the program (default: build/gpu/app/b3dgs)
#   KERNELS              kernels by name, a regular expression (default: the forward and backward blend)
#
# Needs ncu, python3, and permission to read performance counters (root, or the driver's option
# NVreg_RestrictProfilingToAdminUsers=0).
set -euo pipefail
if [[ ${1:-} == -h || ${1:-} == --help ]]; then
  sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
  exit 0
fi
here=$(cd "$(dirname "$0")/.." && pwd)
export PATH=$PATH:/usr/local/cuda/bin
b3dgs=${B3DGS:-$here/build/gpu/app/b3dgs}
kernels=${KERNELS:-forward_.*_kernel|backward_.*_kernel|sum_behind_kernel|(naive|dynamic|gaussian_wise|combined|shared_memory)_kernel}
# Kernels that belong to forward_segmented_kernel.
if [[ -z ${KERNELS:-} ]]; then kernels+='|cut_lists_kernel|finish_pixels_kernel'; fi

fail() {
  echo "profile_kernels.sh: $*" >&2
  exit 1
}
command -v ncu >/dev/null || fail "ncu was not found; it comes with the CUDA toolkit (cuda-nsight-compute)"
command -v python3 >/dev/null || fail "python3 was not found"
[[ -x $b3dgs ]] || fail "$b3dgs is no program; build with scripts/run_gpu_tests.sh, or set B3DGS"

metrics=(
  gpu__time_duration.sum
  launch__registers_per_thread
  launch__block_size
  launch__grid_size
  sm__maximum_warps_per_active_cycle_pct           # theoretical occupancy
  sm__warps_active.avg.pct_of_peak_sustained_active # achieved, while a multiprocessor is active
  sm__cycles_active.avg
  sm__cycles_elapsed.max
)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
ncu --clock-control none --csv --page raw --print-units base --log-file "$folder/ncu.csv" \
  --kernel-name "regex:$kernels" --metrics "$(IFS=,; echo "${metrics[*]}")" \
  "$b3dgs" bench kernels "$@" --device cuda --repeat 1 >"$folder/bench.txt" ||
  { cat "$folder/bench.txt" "$folder/ncu.csv" >&2; fail "ncu failed"; }
sed '/^$/,$d' "$folder/bench.txt" # scene, device and lists; times under a profiler are meaningless

python3 - "$folder/ncu.csv" <<'PYTHON'
import csv, re, sys

lines = open(sys.argv[1], encoding="utf-8", errors="replace").read().splitlines()
start = next((i for i, line in enumerate(lines) if line.startswith('"ID"')), None)
if start is None:
    sys.exit("profile_kernels.sh: ncu profiled nothing:\n" + "\n".join(lines[-20:]))


def number(row, metric):
    try:
        return float(row[metric].replace(",", ""))
    except (KeyError, ValueError):
        return float("nan")


first = {}  # launch of each kernel; a forward kernel's first launch does not keep states for a backward pass
for row in csv.DictReader(lines[start:]):
    if not row["ID"].isdigit():  # the line of units, messages
        continue
    name = re.sub(r"\([\w: ]+\)(?=\d)", "", row["Kernel Name"])
    found = re.search(r"\w+_kernel(<[^(]*>)?", name)
    first.setdefault(found.group(0) if found else name, row)

print(f"{'kernel':<42} {'ms':>9} {'grid':>8} {'threads':>8} {'registers':>9} {'theoretical':>12} {'achieved':>9}"
      f" {'SM active':>10}")
for name, row in first.items():
    active = 100 * number(row, "sm__cycles_active.avg") / (number(row, "sm__cycles_elapsed.max") or float("nan"))
    print(f"{name:<42} {number(row, 'gpu__time_duration.sum') / 1e6:9.3f} {number(row, 'launch__grid_size'):8.0f}"
          f" {number(row, 'launch__block_size'):8.0f} {number(row, 'launch__registers_per_thread'):9.0f}"
          f" {number(row, 'sm__maximum_warps_per_active_cycle_pct'):10.1f} %"
          f" {number(row, 'sm__warps_active.avg.pct_of_peak_sustained_active'):7.1f} % {active:8.1f} %")
PYTHON
