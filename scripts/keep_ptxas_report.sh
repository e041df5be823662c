#!/usr/bin/env bash
# Runs a compiler command. The report of ptxas about the kernels (-Xptxas=-v) goes to a file beside the object,
# X.cu.o.ptxas, instead of the build's output. CMake puts this before every compilation if B3DGS_PTXAS_REPORTS is on.
set -uo pipefail

object=
for ((i = 1; i < $#; ++i)); do
  if [[ ${!i} == -o ]]; then next=$((i + 1)); object=${!next}; fi
done
if [[ $object != *.cu.o ]]; then exec "$@"; fi

said=$(mktemp)
trap 'rm -f "$said"' EXIT
"$@" 2>"$said"
status=$?
is_ptxas='^ptxas info|^ +[0-9]+ bytes stack frame'
grep -Ev "$is_ptxas" "$said" >&2
if ((status == 0)); then grep -E "$is_ptxas" "$said" >"$object.ptxas"; fi
exit "$status"
