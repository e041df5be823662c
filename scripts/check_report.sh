#!/usr/bin/env bash
# Opens a report in chromium (headless, without network) and takes a screenshot. Fails if the page refers to external
# resources, writes to the browser's console, or is blank; exits with 77 if chromium is not installed.
# Usage: scripts/check_report.sh REPORT.html [SCREENSHOT.png] [light|dark]
set -euo pipefail

report=$(realpath "${1:?missing argument; usage: scripts/check_report.sh REPORT.html [SCREENSHOT.png] [light|dark]}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
screenshot=${2:-$work/screenshot.png}
browser=$(command -v chromium || command -v chromium-browser || true)
if [[ -z $browser ]]; then
  echo "check_report.sh: skipped, chromium is not installed (scripts/install_packages.sh)"
  exit 77
fi

if grep -Eo '(src|href|url)(="|\()[^")]{0,40}' "$report" | grep -Ev '="data:'; then
  echo "check_report.sh: $report refers to the external resources above" >&2
  exit 1
fi

flags=(--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --hide-scrollbars --user-data-dir="$work/profile"
  --host-resolver-rules='MAP * ~NOTFOUND' --enable-logging=stderr --virtual-time-budget=5000 --window-size=1000,6000)
if [[ ${3:-light} == dark ]]; then flags+=(--blink-settings=preferredColorScheme=0); fi
if ! HOME=$work timeout 100 "$browser" "${flags[@]}" --screenshot="$screenshot" "file://$report" >"$work/log" 2>&1; then
  cat "$work/log" >&2
  echo "check_report.sh: chromium failed to open $report" >&2
  exit 1
fi
if grep 'CONSOLE' "$work/log" >&2; then
  echo "check_report.sh: $report wrote the messages above to the browser's console" >&2
  exit 1
fi
# A blank page of this size takes 30 kB as PNG, a report several hundred.
if (($(stat -c %s "$screenshot") < 80000)); then
  echo "check_report.sh: the screenshot of $report is blank" >&2
  exit 1
fi
echo "check_report.sh: $report: no faults found"
