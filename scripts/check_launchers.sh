#!/usr/bin/env bash
# Trains a small scene with two processes on this machine's CPUs under each installed launcher (torchrun, mpirun, srun),
# and compares the PLY, byte for byte, with that of one process. Under torchrun and srun, a training is also interrupted
# and continued with --resume auto. Prints what it skipped. srun needs a cluster that responds, no allocation around
# this script, and a TMPDIR that its nodes share.
#
#   scripts/check_launchers.sh
#     TORCHRUN, MPIRUN, SRUN  other commands to use, with options ("python3 -m torch.distributed.run")
#     BUILD_DIR               build folder (default: build/cpu)
set -euo pipefail
cd "$(dirname "$0")/.."
if [[ ${1:-} == -h || ${1:-} == --help ]]; then
  sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
  exit 0
fi
build=${BUILD_DIR:-build/cpu}
if [[ ! -f $build/build.ninja ]]; then
  echo "check_launchers.sh: $build holds no build; configure one (cmake --preset cpu) or set BUILD_DIR" >&2
  exit 2
fi
cmake --build "$build" --target b3dgs >/dev/null
read -ra torchrun <<<"${TORCHRUN:-torchrun}"
read -ra mpirun <<<"${MPIRUN:-mpirun --bind-to none}"
read -ra srun <<<"${SRUN:-srun}"
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
b3dgs=$(realpath "$build/app/b3dgs")
options=(--preset inria --iterations 400 --device cpu --threads 1 --kernel combined --densify_from_iter 50 --densification_interval 50)
failures=0

# NAME COMMAND...: the launcher and its options; trains in the folder NAME
train() {
  local name=$1
  shift
  "$@" "$b3dgs" train "$folder/scene" -m "$folder/$name" "${options[@]}" --checkpoint_iterations 100 200 300 --resume auto \
    >>"$folder/$name.log" 2>&1
}
report() {
  local ply=point_cloud/iteration_400/point_cloud.ply
  if cmp -s "$folder/$1/$ply" "$folder/one/$ply"; then
    echo "ok       $1"
  else
    echo "FAILED   $1; the end of its output:"
    tail -n 20 "$folder/$1.log"
    failures=$((failures + 1))
  fi
}
check() {
  train "$@" || true
  report "$1"
}
is_there() {
  if command -v "$1" >/dev/null; then return 0; fi
  echo "skipped  $1: not installed"
  return 1
}
wait_for_checkpoint() {
  for _ in $(seq 600); do
    if [[ -f $folder/$1/checkpoints/iteration_100.b3dgs ]]; then return; fi
    sleep 0.1
  done
}
# The process identifier of one rank that trains in the folder NAME
one_rank() {
  pgrep -f "train $folder/scene -m $folder/$1 " | while read -r process; do
    if [[ $(<"/proc/$process/comm") == b3dgs ]]; then echo "$process"; fi
  done | tail -n 1
}

"$b3dgs" synth orbit "$folder/scene" --points 2000 --views 16 --width 160 --height 120 --quiet >/dev/null
"$b3dgs" train "$folder/scene" -m "$folder/one" "${options[@]}" --batch 2 \
  >"$folder/one.log" 2>&1
if is_there "${torchrun[0]}"; then
  check torchrun "${torchrun[@]}" --no_python --nproc_per_node 2
  check torchrun_standalone "${torchrun[@]}" --standalone --no_python --nproc_per_node 2
  train torchrun_killed "${torchrun[@]}" --standalone --max_restarts 1 --no_python --nproc_per_node 2 &
  wait_for_checkpoint torchrun_killed
  kill -KILL "$(one_rank torchrun_killed)" || failures=$((failures + 1))
  wait $! || true
  report torchrun_killed
fi
if is_there "${mpirun[0]}"; then check mpirun "${mpirun[@]}" --oversubscribe -n 2; fi
if is_there "${srun[0]}"; then
  if timeout 60 "${srun[@]}" -N1 -n2 true >/dev/null 2>&1; then
    check srun "${srun[@]}" -N1 -n2
    train srun_stopped "${srun[@]}" -N1 -n2 --job-name b3dgs_check &
    wait_for_checkpoint srun_stopped
    scancel --me --name b3dgs_check
    if wait $!; then
      echo "FAILED   srun_stopped: was not interrupted"
      failures=$((failures + 1))
    fi
    check srun_stopped "${srun[@]}" -N1 -n2
  else
    echo "skipped  ${srun[0]}: no cluster answers, or it has no node for two tasks"
  fi
fi
exit $((failures > 0))
