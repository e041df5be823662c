#!/usr/bin/env bash
# Registers, stack, spills and static shared memory of every kernel, for each architecture of the preset cuda-compile,
# as ptxas reported them during the build. CUB's kernels are left out.
#
#   scripts/kernel_resources.sh            prints the table
#   scripts/kernel_resources.sh --update   writes it to docs/kernel_resources.txt
#   scripts/kernel_resources.sh --check    fails if that file says anything else. Another nvcc compiles to other
#                                          numbers: the file is then not compared
#
# Build first: scripts/compile_cuda.sh. BUILD_DIR names another build folder, configured with -DB3DGS_PTXAS_REPORTS=ON.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH=$PATH:/usr/local/cuda/bin LC_ALL=C
build=${BUILD_DIR:-build/cuda-compile}
table=docs/kernel_resources.txt

fail() {
  echo "kernel_resources.sh: $*" >&2
  exit 1
}

# "V13.0.88" of the nvcc that the build used, which need not be the first on the PATH.
compiler_version() {
  local nvcc
  nvcc=$(sed -n 's/^CMAKE_CUDA_COMPILER:[A-Z]*=//p' "$build/CMakeCache.txt")
  "${nvcc:-nvcc}" --version | sed -n 's/.*release.*, \(V[0-9.]*\).*/\1/p'
}

# ptxas' report of one source to lines "mangled name|sm|registers|stack|spill stores|spill loads|shared".
parse_report() {
  awk '
    /Compiling entry function/ { split($0, quoted, "\047"); kernel = quoted[2]; sm = quoted[4] }
    /Function properties for/  { is_kernel = ($NF == kernel) }
    /bytes stack frame/ && is_kernel { stack = $1; stores = $5; loads = $9 }
    /: Used [0-9]+ registers/ {
      shared = 0
      for (i = 1; i <= NF; ++i) {
        if ($i == "registers,") registers = $(i - 1)
        if ($i ~ /^smem/) shared = $(i - 2)
      }
      print kernel "|" sm "|" registers "|" stack "|" stores "|" loads "|" shared
    }' "$1"
}

# The header, then a line for each kernel and architecture.
print_table() {
  local source module report
  echo "# What ptxas of nvcc $(compiler_version) says of every kernel. Written by scripts/kernel_resources.sh --update."
  echo "# Bytes: stack and spills per thread, static shared memory per block."
  printf '%-46s %-38s %-6s %9s %6s %12s %11s %7s\n' \
    '# source' kernel arch registers stack spill_stores spill_loads shared
  find src -name '*.cu' | sort | while read -r source; do
    module=$(cut -d/ -f1,2 <<<"$source")
    report=$(find "$build/$module/CMakeFiles" -path "*.dir/${source#"$module"/}.o.ptxas" 2>/dev/null | head -n 1)
    [[ -n $report ]] || fail "$source has no report below $build; build with scripts/compile_cuda.sh first"
    # From "void b3dgs::cuda::(anonymous namespace)::name<128>(b3dgs::Args)" to "name<128>", and so for the rows of
    # row_kernel<&b3dgs::name, 128, b3dgs::Args>(...) and each_row_kernel<128, b3dgs::cuda::name(...)::{lambda...}>(...)
    parse_report "$report" | c++filt | grep -v '\bcub::' |
      sed -E 's/each_row_kernel<([0-9]+), ([A-Za-z0-9_:<>]+)\([^|]*\|/\2<\1>|/; s/^void //; s/b3dgs::|cuda::|\(anonymous namespace\):://g; s/\([A-Za-z ]+\)([0-9]+)/\1/g; s/\([^|]*\|/|/;
        s/row_kernel<&([a-z0-9_]+), ([0-9]+), [A-Za-z]+>/\1<\2>/' |
      awk -F'|' -v source="${source#src/}" '{
        printf "%-46s %-38s %-6s %9d %6d %12d %11d %7d\n", source, $1, $2, $3, $4, $5, $6, $7 }' | sort
  done
}

[[ -f $build/CMakeCache.txt ]] || fail "$build is no build folder; build with scripts/compile_cuda.sh first"
case ${1:-} in
  '') print_table ;;
  --update)
    print_table >"$build/kernel_resources.txt"
    cp "$build/kernel_resources.txt" "$table"
    echo "$table: $(grep -vc '^#' "$table") rows"
    ;;
  --check)
    version=$(compiler_version)
    if ! grep -q "nvcc $version " "$table"; then
      echo "$table is not compared: it was made with nvcc $(sed -n 's/.*nvcc \(V[0-9.]*\) .*/\1/p' "$table"), this is $version"
      exit 0
    fi
    print_table >"$build/kernel_resources.txt"
    if changes=$(diff -U 0 "$table" "$build/kernel_resources.txt"); then
      echo "kernel resources are as in $table"
      exit 0
    fi
    grep '^[-+][^-+]' <<<"$changes" >&2
    fail "kernel resources changed (- $table, + this build): if that is meant, run scripts/kernel_resources.sh --update" \
      "and commit it"
    ;;
  *) fail "unknown option $1; known are --update and --check" ;;
esac
