#!/usr/bin/env bash
# Checks every Markdown file of the repository. Relative links must lead to a file (and to one of its headings if the
# link names one), and no line may be longer than 100 columns, except for tables, code blocks and the targets of links.
# Files named from the top (`src/...`, `scripts/...`) must exist, and so must tests that docs/ names (`Suite.Name`, with
# * for any rest).
# Prints each fault as FILE:LINE and a description. Exit code 1 if there are any.
# Usage: scripts/check_links.sh [FILE.md ...]    default: all files that git does not ignore
set -euo pipefail
cd "$(dirname "$0")/.."
export LC_ALL=C.UTF-8
readonly max_columns=100

if (($# > 0)); then
  files=("$@")
else
  mapfile -t files < <(git ls-files --cached --others --exclude-standard -- '*.md' | sort)
fi
faults=0

fail() {
  echo "$1"
  faults=$((faults + 1))
}

# without_code FILE: prints the file with the lines of fenced or indented code blocks empty. Keeps line numbers.
without_code() {
  awk '
    /^ *```/ { is_fenced = !is_fenced; print ""; was_blank = 0; next }
    is_fenced { print ""; next }
    /^    / && (was_blank || is_indented) { is_indented = 1; print ""; next }
    { is_indented = 0; was_blank = ($0 ~ /^ *$/); print }
  ' "$1"
}

# anchors FILE: prints the names that GitHub gives the headings.
anchors() {
  without_code "$1" | sed -nE 's/^#+ +//p' | sed -E 's/\[([^]]*)\]\([^)]*\)/\1/g; s/[^[:alnum:] _-]//g; s/ /-/g' |
    tr '[:upper:]' '[:lower:]'
}

check_link() {
  local file=$1 line=$2 target=$3 path anchor
  case $target in
    *://* | mailto:*) return ;;
  esac
  path=${target%%#*}
  anchor=${target#"$path"}
  if [[ -z $path ]]; then path=$file; else path=$(dirname "$file")/$path; fi
  if [[ ! -e $path ]]; then
    fail "$file:$line: link to a file that does not exist: $target"
  elif [[ -n $anchor && $path == *.md ]] && ! anchors "$path" | grep -qxF -- "${anchor#\#}"; then
    fail "$file:$line: link to a heading that does not exist: $target"
  fi
}

# Suite.Name of every test, also if the macro spans two lines.
tests=$(find tests -name '*.cpp' -exec cat {} + | tr '\n' ' ' | grep -oE 'TEST(_F|_P)?\( *[A-Za-z0-9_]+, *[A-Za-z0-9_]+' |
  sed -E 's/.*\( *//; s/, */./')

check_test() {
  grep -qE "^$(sed 's/\./\\./; s/\*/.*/' <<<"$3")\$" <<<"$tests" || fail "$1:$2: no such test: $3"
}

for file in "${files[@]}"; do
  [[ -f $file ]] || { fail "$file: no such file"; continue; }
  while IFS=: read -r line target; do
    target=${target#](}
    target=${target%)}
    check_link "$file" "$line" "${target%% *}"
  done < <(without_code "$file" | grep -noE '\]\([^)]+\)' || true)
  while IFS=: read -r line name; do
    [[ $file == docs/* ]] && check_test "$file" "$line" "${name//\`/}"
  done < <(grep -noE '`[A-Z][A-Za-z0-9]+\.[A-Za-z0-9]*\*?`' "$file" | grep -vE '\.(md|txt|html)`' || true)
  while IFS=: read -r line path; do
    path=${path//\`/}
    [[ -e $path ]] || fail "$file:$line: no such file: $path"
  done < <(without_code "$file" | grep -noE '`(src|app|tests|scripts|docs|cmake|data_synth)/[a-z0-9_./-]+`' || true)
  while IFS=: read -r line _; do
    fail "$file:$line: longer than $max_columns columns"
  done < <(without_code "$file" | sed -E '/^ *\|/s/.*//; s/\]\([^)]*\)/]/g; s/<?https?:[^ )>]*>?//g' |
    grep -nE "^.{$((max_columns + 1)),}" || true)
done

if ((faults > 0)); then
  echo "check_links.sh: $faults faults in ${#files[@]} files" >&2
  exit 1
fi
echo "check_links.sh: ${#files[@]} files, no faults"
