#!/usr/bin/env bash
# Opens a report in chromium (headless, without network): on a desktop in light and dark mode, and on a phone. Fails if
# the page refers to external resources, writes to the browser's console, is wider than the window, or if a chart is not
# drawn with its values (check_report.js). Exits with 77 if chromium is not installed. Keeps light.png, dark.png,
# phone.png and the text that the page shows, text.txt, in FOLDER.
# Usage: scripts/check_report.sh REPORT.html [FOLDER]
set -euo pipefail

report=$(realpath "${1:?missing argument; usage: scripts/check_report.sh REPORT.html [FOLDER]}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
folder=${2:-$work/pictures}
mkdir -p "$folder"
browser=$(command -v chromium || command -v chromium-browser || true)
if [[ -z $browser ]]; then
  echo "check_report.sh: skipped, chromium is not installed (scripts/install_packages.sh)"
  exit 77
fi

if grep -Eo '(src|href|url)(="|\()[^")]{0,40}' "$report" | grep -Ev '="data:'; then
  echo "check_report.sh: $report refers to the external resources above" >&2
  exit 1
fi
{ cat "$report"; echo "<script>"; cat "$(dirname "$0")/check_report.js"; echo "</script>"; } >"$work/report.html"

# check NAME WIDTH HEIGHT FLAGS...: shows the page in a frame, because windows are at least 500 px wide.
check() {
  local name=$1 width=$2 height=$3
  shift 3
  cat >"$work/$name.html" <<HTML
<body style="margin: 0"><iframe src="report.html" style="border: 0; width: ${width}px; height: ${height}px"></iframe>
<pre id="faults">no answer</pre><pre id="text"></pre>
<script>addEventListener("message", ({data}) => {
  document.getElementById("faults").textContent = data.faults.map((own) => "fault: " + own).join("\n");
  document.getElementById("text").textContent = data.text;
});</script>
HTML
  local flags=(--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --hide-scrollbars
    --user-data-dir="$work/profile" --host-resolver-rules='MAP * ~NOTFOUND' --enable-logging=stderr
    --virtual-time-budget=8000 --window-size="$width,$height" "$@")
  if ! HOME=$work timeout 100 "$browser" "${flags[@]}" --screenshot="$folder/$name.png" --dump-dom \
    "file://$work/$name.html" >"$work/dom" 2>"$work/log"; then
    cat "$work/log" >&2
    echo "check_report.sh: chromium failed to open $report" >&2
    exit 1
  fi
  sed -n '/id="text">/,/^<script/p' "$work/dom" >"$folder/text.txt"
  if grep 'CONSOLE' "$work/log" >&2 || grep -E '^(<pre id="faults">)?(fault:|no answer)' "$work/dom" >&2; then
    echo "check_report.sh: $report ($name): the faults above" >&2
    exit 1
  fi
}
check light 1000 8000
check dark 1000 8000 --blink-settings=preferredColorScheme=0
check phone 390 12000
echo "check_report.sh: $report: no faults found in $(grep -om1 '[0-9]* charts' "$folder/text.txt")"
