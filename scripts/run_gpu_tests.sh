#!/usr/bin/env bash
# On a machine with a GPU: builds, runs every test that needs one, then those of parity under compute-sanitizer
# (memcheck, racecheck, initcheck, synccheck), and writes a short report. Fails if any of these fails.
#
#   scripts/run_gpu_tests.sh [OPTIONS] [-- CMAKE_ARGUMENT ...]
#     --quick            fewer scenes under the sanitizers
#     --all-scenes       every raster test under every sanitizer, long lists included, on which a tool takes minutes
#     --only WHAT        parity (the tests alone) or sanitizer
#     --no-build         what BUILD_DIR holds is tested as it is
#     --report FILE      where the report goes (default: BUILD_DIR/gpu_report.md)
#   BUILD_DIR            build folder, kept from run to run (default: build/gpu)
#   SANITIZER_TIMEOUT    seconds for each sanitizer and test program (default: 150; with --all-scenes 10800)
#
# Example: scripts/run_gpu_tests.sh --report gpu.md -- -DCMAKE_PREFIX_PATH=/opt/libtorch
set -uo pipefail
cd "$(dirname "$0")/.." || exit 2
export PATH=$PATH:/usr/local/cuda/bin:/usr/local/cuda/compute-sanitizer B3DGS_REQUIRE_GPU=1
build=${BUILD_DIR:-build/gpu}
is_quick=false has_all_scenes=false only=all has_build=true report=

# Scenes under the sanitizers cover each branch of the kernels, but no long lists, on which a tool takes minutes.
few_scenes='*/thirty_three_in_one_tile:*/odd_image_size:*/saturated_pixels:SegmentedCuda.CutLists*'
most_scenes="$few_scenes:*/empty:*/one_splat:*/splat_on_tile_corner:*/around_the_near_plane:*/opaque_front_layer"
most_scenes+=":*/one_pixel_image:*/anisotropic_cloud:*/near_the_cutoff:*/no_higher_degrees"

fail() {
  echo "run_gpu_tests.sh: $*" >&2
  exit 2
}

while (($# > 0)); do
  case $1 in
    --quick) is_quick=true ;;
    --all-scenes) has_all_scenes=true ;;
    --only)
      only=${2:-}
      [[ $only == parity || $only == sanitizer ]] || fail "--only takes parity or sanitizer, found \"$only\""
      shift
      ;;
    --no-build) has_build=false ;;
    --report)
      report=${2:-}
      [[ -n $report ]] || fail "--report takes a file"
      shift
      ;;
    --)
      shift
      break
      ;;
    -h | --help)
      sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
      exit 0
      ;;
    *) fail "unknown option $1; see --help (arguments for CMake go after --)" ;;
  esac
  shift
done
if $is_quick && $has_all_scenes; then fail "--quick and --all-scenes exclude each other"; fi
report=${report:-$build/gpu_report.md}
logs=$build/gpu_logs
sanitizer_timeout=${SANITIZER_TIMEOUT:-$($has_all_scenes && echo 10800 || echo 150)}
rows=() failed=0

# add_row WHAT RESULT SECONDS DETAIL: a line of the report; any RESULT but "passed" fails the run.
add_row() {
  rows+=("| $1 | $2 | $3 s | $4 |")
  [[ $2 == passed ]] || failed=1
  echo "$1: $2 ($3 s) $4"
}

configure_and_build() {
  local capability
  capability=$(nvidia-smi --query-gpu=compute_cap --format=csv,noheader | head -n 1 | tr -d '.')
  cmake -S . -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DB3DGS_CUDA=ON -DB3DGS_TESTS=ON \
    -DCMAKE_CUDA_ARCHITECTURES="$capability" "$@" &&
    cmake --build "$build" --parallel "$(nproc)"
}

run_parity() {
  local start=$SECONDS log=$logs/parity.log status detail
  # The references run on the CPU. If each of several tests used all its threads, they would slow each other down.
  OMP_NUM_THREADS=2 ctest --test-dir "$build" -L gpu --output-on-failure --no-tests=error --parallel "$(($(nproc) < 8 ? $(nproc) : 8))" \
    >"$log" 2>&1
  status=$?
  detail=$(sed -n 's/.*tests passed, \([0-9]*\) tests failed out of \([0-9]*\)/\1 of \2 suites failed/p' "$log")
  detail+=$(sed -nE '/tests FAILED:/,$ s/^[[:space:]]+[0-9]+ - (.*) \([A-Za-z* ]+\).*/\1/p' "$log" |
    sed 's/^/; /' | head -n 12 | tr -d '\n')
  detail+=$(sed -nE 's/^\[  FAILED  \] ([A-Za-z0-9_\/]+\.[A-Za-z0-9_\/]+).*/\1/p' "$log" | sort -u |
    sed 's/^/; /' | head -n 12 | tr -d '\n')
  ((status == 0)) || tail -n 60 "$log"
  add_row "GPU tests" "$( ((status == 0)) && echo passed || echo FAILED)" $((SECONDS - start)) "${detail:-see $log}"
}

# gpu_test_programs: prints the programs with tests of the label gpu.
gpu_test_programs() {
  ctest --test-dir "$build" -N -V -L gpu | sed -n 's/^[0-9]*: Test command: \([^ ]*\).*/\1/p' | tr -d '"' | sort -u
}

# The filter for a program under a tool, or nothing to leave it out.
sanitizer_filter() {
  local program=$1 tool=$2 tests
  case $program in
    raster_cuda_tests)
      # racecheck follows every access to shared memory and is ten times slower than the others.
      if $has_all_scenes; then
        echo '*'
      elif $is_quick || [[ $tool == racecheck ]]; then
        echo "$few_scenes"
      else
        echo "$most_scenes"
      fi
      ;;
    # Whole trainings take minutes under a tool.
    train_cuda_tests)
      tests='ImageUploader*:SplitSamples*:*LossOnGpu*:*GaussianStepOnGpu*:DeferredSh.*:BatchOnGpu.EqualsTheCpu*'
      tests+=':AppearanceOnGpu.*OfTheCpu*:DepthPriorsOnGpu.Gradient*:RegularizationOnGpu.*'
      tests+=':ReduceImageOnGpu.*:RowEditorOnGpu.*:BudgetOnGpu.ErrorImage*'
      # initcheck makes the host wait for the end of each copy, but this test delays a copy until the host has
      # continued.
      if [[ $tool == initcheck ]]; then tests+=':-ImageUploaderTest.NeverWritesASlotThatIsStillRead'; fi
      # These run hundreds of steps, and racecheck covers the same kernels in GaussianStepOnGpu.
      if [[ $tool == racecheck ]]; then tests+=':-DeferredSh.UpdatesGiveTheSameBits*'; fi
      if ! $is_quick; then echo "$tests"; fi
      ;;
    *) if ! $is_quick; then echo '*Cuda*'; fi ;;
  esac
}

run_sanitizer() {
  local tool=$1 program=$2 filter=$3 start=$SECONDS name log status result tests summary
  name=$(basename "$program")
  log=$logs/$tool-$name.log
  timeout "$sanitizer_timeout" compute-sanitizer --tool "$tool" --error-exitcode 99 "$program" \
    --gtest_filter="$filter" >"$log" 2>&1
  status=$?
  tests=$(sed -n 's/^\[=*\] \([0-9]*\) tests\{0,1\} from .* ran\..*/\1/p' "$log")
  summary=$(grep -E '^=+ (ERROR|RACECHECK) SUMMARY' "$log" | tail -n 1 | sed 's/^=* //')
  if ((status == 0)) && [[ $tests == 0 ]]; then return; fi  # this program has no such tests
  result=FAILED
  if ((status == 0)) && [[ $summary == *': 0 errors'* || $summary == *': 0 hazards'* ]]; then result=passed; fi
  if ((status == 124)); then result="TIMED OUT"; fi
  [[ $result == passed ]] || tail -n 40 "$log"
  add_row "$tool, $name" "$result" $((SECONDS - start)) "${tests:-?} tests; ${summary:-see $log}"
}

run_sanitizers() {
  local tool program filter programs
  if ! command -v compute-sanitizer >/dev/null; then
    add_row compute-sanitizer "NOT RUN" 0 "not found; it comes with the CUDA toolkit (cuda-sanitizer)"
    return
  fi
  programs=$(gpu_test_programs)
  for tool in memcheck racecheck initcheck synccheck; do
    for program in $programs; do
      filter=$(sanitizer_filter "$(basename "$program")" "$tool")
      if [[ -n $filter ]]; then run_sanitizer "$tool" "$program" "$filter"; fi
    done
  done
}

write_report() {
  local commit changes compiler
  commit=$(git rev-parse --short HEAD 2>/dev/null || echo unknown)
  changes=$(git status --porcelain 2>/dev/null | head -n 1)
  compiler=$(sed -n 's/^set(CMAKE_CUDA_COMPILER_VERSION "\(.*\)")/\1/p' "$build"/CMakeFiles/*/CMakeCUDACompiler.cmake 2>/dev/null)
  mkdir -p "$(dirname "$report")"
  {
    echo "# GPU tests: $( ((failed == 0)) && echo passed || echo FAILED)"
    echo
    echo "- commit $commit${changes:+, with uncommitted changes}"
    echo "- $(date -u '+%Y-%m-%d %H:%M UTC')"
    nvidia-smi --query-gpu=name,driver_version,compute_cap --format=csv,noheader |
      sed 's/\(.*\), \(.*\), \(.*\)/- \1 (compute capability \3), driver \2/' | sort | uniq -c | sed 's/^ *1 //'
    echo "- CUDA ${compiler:-of unknown version}"
    echo "- $(if $is_quick; then echo 'quick: few scenes under the sanitizers';
        elif $has_all_scenes; then echo 'every scene under the sanitizers'; else echo 'all GPU tests'; fi), total ${SECONDS} s"
    echo
    echo '| what | result | time | detail |'
    echo '|---|---|---|---|'
    printf '%s\n' "${rows[@]}"
  } >"$report.tmp" && mv "$report.tmp" "$report" && echo "report: $report"
}

nvidia-smi >/dev/null 2>&1 || fail "no GPU: nvidia-smi does not answer"
if $has_build; then
  if ! configure_and_build "$@"; then
    add_row build FAILED "$SECONDS" "the tests were not run"
    write_report
    exit 1
  fi
fi
[[ -f $build/CTestTestfile.cmake ]] || fail "$build holds no build with tests; run without --no-build, or set BUILD_DIR"
mkdir -p "$logs"
if [[ $only != sanitizer ]]; then run_parity; fi
if [[ $only != parity ]]; then run_sanitizers; fi
((${#rows[@]} > 0)) || add_row "GPU tests" "NOT RUN" 0 "nothing was found to run"
write_report || exit 2
exit "$failed"
