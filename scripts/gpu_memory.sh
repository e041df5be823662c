#!/usr/bin/env bash
# Measures the GPU memory of a training, and its behaviour when there is too little: peak, Gaussians, time and quality
# of a few trainings, as a table. Fails if one does not end as expected.
#
#   scripts/gpu_memory.sh OUTPUT [CASE ...]
#     scene              SCENE for 30,000 iterations: at most 2.5 GB
#     capped             SCENE with a low threshold of growth and --gpu_memory_gb 2: capped, trained to the end
#     short              the same while another process leaves 4 GiB of the GPU
#     large              20 million points: 500 steps, checkpoint, resumed to 520, PLY, evaluation
#     huge               likewise 50 million
#   SCENE                a COLMAP scene (for the first three cases)
#   B3DGS                the program (default: build/gpu/app/b3dgs)
#   PYTHON               a Python with PyTorch, for `short` (default: python3)
set -uo pipefail
if [[ $# -eq 0 || $1 == -h || $1 == --help ]]; then
  sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
  exit 0
fi
here=$(cd "$(dirname "$0")/.." && pwd)
b3dgs=${B3DGS:-$here/build/gpu/app/b3dgs}
out=$1
shift
cases=("${@:-scene}")
rows=() failed=0
mkdir -p "$out" || exit 2
[[ -x $b3dgs ]] || {
  echo "gpu_memory.sh: $b3dgs is not there; build it or set B3DGS" >&2
  exit 2
}

# last_of MODEL KEY: the last value of a key in train.jsonl.
last_of() {
  sed -nE "s/.*\"$2\":([0-9.]+).*/\1/p" "$1/train.jsonl" 2>/dev/null | tail -n 1
}

# add_row NAME MODEL RESULT DETAIL: a line of the table; any RESULT but "as it should" fails the run.
add_row() {
  local peak held
  peak=$(last_of "$2" gpu_peak_bytes)
  held=$(sed -nE 's/.*"event":"capped".*"count":([0-9]+).*/\1/p' "$2/train.jsonl" 2>/dev/null | tail -n 1)
  rows+=("| $1 | $(last_of "$2" count) | ${held:--} | $(awk "BEGIN { printf \"%.2f\", ${peak:-0} / 1e9 }") GB | $(last_of "$2" elapsed_s) s | $(last_of "$2" test_psnr) | $3 | $4 |")
  [[ $3 == "as it should" ]] || failed=1
}

# train NAME MODEL ARGUMENT ...: trains on the GPU; its output goes to OUTPUT/NAME.log.
train() {
  local name=$1 model=$2
  shift 2
  "$b3dgs" train -m "$model" --device cuda "$@" >"$out/$name.log" 2>&1
}

# judge CONDITION: prints how a case ended, from a command that tests it.
judge() {
  if "$@"; then echo "as it should"; else echo "NOT AS IT SHOULD"; fi
}

at_most_gb() {
  awk "BEGIN { exit !(${1:-1e99} <= $2 * 1e9) }"
}

# was_held STATUS MODEL
was_held() {
  (($1 == 0)) && grep -q '"event":"capped"' "$2/train.jsonl"
}

run_scene() {
  train scene "$out/scene" -s "$SCENE" --eval --preset inria --overwrite
  local status=$?
  add_row "scene, 30,000" "$out/scene" \
    "$(judge at_most_gb "$( ((status == 0)) && last_of "$out/scene" gpu_peak_bytes)" 2.5)" "exit $status"
}

# run_held NAME ARGUMENT ...
run_held() {
  local name=$1
  shift
  train "$name" "$out/$name" -s "$SCENE" --eval --preset inria --iterations 12000 --densify_grad_threshold 0.00003 --overwrite "$@"
  local status=$?
  add_row "$name" "$out/$name" "$(judge was_held "$status" "$out/$name")" \
    "exit $status; $(grep -m 1 -h 'capped at' "$out/$name.log")"
}

run_short() {
  "${PYTHON:-python3}" -c '
import time, torch
free, _ = torch.cuda.mem_get_info()
block = torch.empty(free - (4 << 30), dtype=torch.uint8, device="cuda")
print("holds", flush=True)
time.sleep(3600)' >"$out/holder.log" 2>&1 &
  local holder=$!
  for _ in $(seq 120); do
    grep -q holds "$out/holder.log" && break
    sleep 0.5
  done
  run_held short
  kill $holder
  wait $holder 2>/dev/null
}

# run_points NAME POINTS
run_points() {
  local name=$1 points=$2 status=0 first
  "$b3dgs" synth street "$out/$name-scene" --points "$points" --views 16 --width 1600 --height 900 --overwrite --quiet >"$out/$name-synth.log" 2>&1 &&
    train "$name" "$out/$name" -s "$out/$name-scene" --eval --preset inria --iterations 500 --checkpoint_iterations 500 --densify_from_iter 200 --overwrite
  status=$?
  first=$(last_of "$out/$name" gpu_peak_bytes)
  if ((status == 0)); then
    train "$name-resumed" "$out/$name" --resume auto --iterations 520 && "$b3dgs" eval -m "$out/$name" >"$out/$name-eval.log" 2>&1
    status=$?
  fi
  add_row "$name, $points points" "$out/$name" "$(judge test "$status" -eq 0)" \
    "exit $status; first run's peak $(awk "BEGIN { printf \"%.2f\", ${first:-0} / 1e9 }") GB; $(tail -n 1 "$out/$name-eval.log" 2>/dev/null)"
}

for name in "${cases[@]}"; do
  echo "$name ..."
  case $name in
    scene | capped | short) [[ -d ${SCENE:-} ]] || {
      echo "gpu_memory.sh: $name needs SCENE, the folder of a COLMAP scene" >&2
      exit 2
    } ;;&
    scene) run_scene ;;
    capped) run_held capped --gpu_memory_gb 2 ;;
    short) run_short ;;
    large) run_points large 20000000 ;;
    huge) run_points huge 50000000 ;;
    *)
      echo "gpu_memory.sh: unknown case \"$name\"; see --help" >&2
      exit 2
      ;;
  esac
done
echo
echo '| what | Gaussians | capped at | GPU memory at most | training | PSNR, dB | ended | |'
echo '|---|---|---|---|---|---|---|---|'
printf '%s\n' "${rows[@]}"
exit $failed
