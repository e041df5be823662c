#!/usr/bin/env bash
# Fuzzes the file readers with libFuzzer (clang 14) and the address and undefined-behaviour sanitizers.
# Usage: scripts/fuzz.sh [MINUTES_EACH] [TARGET...]    default: 5 minutes for every target in tests/fuzz
# A target stops at its first finding, which is minimised; its path is printed. After fixing the reader, add the file to
# tests/corpus/TARGET/, which ctest reads in every build. Inputs that reach new code are kept in build/fuzz/corpus/ for the
# next run. FUZZ_SECONDS overrides the minutes.
set -euo pipefail
cd "$(dirname "$0")/.."

minutes=${1:-5}
seconds=${FUZZ_SECONDS:-$((minutes * 60))}
shift || true
targets=("$@")
if ((${#targets[@]} == 0)); then
  mapfile -t targets < <(sed -n 's/^b3dgs_add_fuzz_target(\([a-z_]*\) .*/\1/p' tests/fuzz/CMakeLists.txt)
fi

scripts/install_packages.sh --tests clang-14 libclang-rt-14-dev libomp-14-dev
cmake --preset cpu
cmake --build --preset cpu --target write_seeds
cmake --preset fuzz
cmake --build --preset fuzz --target "${targets[@]/#/fuzz_}"

out=build/fuzz
build/cpu/tests/fuzz/write_seeds "$out/seeds"
mkdir -p "$out/findings" "$out/logs"
# Leaks are not checked: readers own memory only through containers, and report errors as exceptions.
export ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1
limits=(-timeout=10 -rss_limit_mb=2048 -malloc_limit_mb=1024 -max_len=16384)

total=0 n_findings=0
for target in "${targets[@]}"; do
  program=$out/tests/fuzz/fuzz_$target
  finding=$out/findings/$target
  log=$out/logs/$target.txt
  mkdir -p "$out/corpus/$target" "tests/corpus/$target"
  rm -f "$finding"
  status=0
  nice "$program" "$out/corpus/$target" "$out/seeds/$target" "tests/corpus/$target" "${limits[@]}" \
    -max_total_time="$seconds" -exact_artifact_path="$finding" -print_final_stats=1 >"$log" 2>&1 || status=$?
  executions=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
  total=$((total + ${executions:-0}))
  echo "$target: ${executions:-0} executions, $(find "$out/corpus/$target" -type f | wc -l) inputs kept"
  ((status == 0)) && continue
  n_findings=$((n_findings + 1))
  if [[ ! -s $finding ]]; then
    echo "$target: exited with status $status; see $log" >&2
    continue
  fi
  "$program" -minimize_crash=1 -runs=20000 "${limits[@]}" -exact_artifact_path="$finding.small" "$finding" \
    >"$log.minimise" 2>&1 || true
  [[ -s $finding.small ]] && mv "$finding.small" "$finding"
  grep -m 3 -E 'ERROR|runtime error|what\(\)|LogicError' "$log" >&2 || true
  echo "$target: FINDING: $finding ($(stat -c %s "$finding") bytes), log: $log" >&2
done
rmdir --ignore-fail-on-non-empty tests/corpus/* 2>/dev/null || true
echo "all targets: $total executions, $n_findings findings"
((n_findings == 0))
