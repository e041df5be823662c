#!/usr/bin/env bash
# After ctest: lists the tests of GoogleTest that were skipped, with the reason, from the log of the run. ctest itself
# names only suites in which all tests were skipped.
# Usage: scripts/list_skipped.sh BUILD_FOLDER
set -euo pipefail
log=$1/Testing/Temporary/LastTest.log
[[ -f $log ]] || { echo "list_skipped.sh: error: $log not found; run ctest first" >&2; exit 2; }
awk '
  /: Skipped$/ { is_reason = 1; reason = ""; next }
  /^\[  SKIPPED \] [^ ]+ \(/ { print "  " $4 ": " (reason == "" ? "no reason given" : reason); ++n; is_reason = 0 }
  is_reason && NF > 0 { reason = reason (reason == "" ? "" : " ") $0 }
  END { print (n > 0 ? n : "no") (n == 1 ? " test was" : " tests were") " skipped" }
' "$log"
