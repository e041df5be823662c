#!/usr/bin/env bash
# Checks what can be counted of the language (CONTRIBUTING.md, "Language"): comments that begin with "Of" or "What",
# semicolons and long sentences in README and docs, and the subjects of commits since this script was added.
# Usage: scripts/check_prose.sh [--list] [FOLDER...]    --list: prints each place; FOLDER: only what lies there
set -euo pipefail
cd "$(dirname "$0")/.."

python3 - "$@" <<'PYTHON'
import re, subprocess, sys

COMMENTS, SEMICOLONS, LONG_SENTENCES = 10, 5.0, 0  # limits: in all, in 1000 words, in all
LONGEST_SENTENCE, LONGEST_SUBJECT = 35, 72  # words, characters

lists = "--list" in sys.argv
folders = [a for a in sys.argv[1:] if a != "--list"]


def git(*arguments):
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True).stdout


files = [f for f in git("ls-files").splitlines() if not folders or any(f.startswith(d.rstrip("/")) for d in folders)]
faults = 0


def check(what, places, limit, value=None):
    global faults
    value = len(places) if value is None else value
    print(f"{what}: {value:.3g}, limit {limit:g}")
    if lists or value > limit:
        print("".join(f"  {place}\n" for place in places), end="")
    faults += value > limit


places = []
for file in files:
    if re.search(r"\.(cpp|h|cu|cuh|c|js|cjs|css|py|sh|cmake|txt)$", file) and not file.startswith("docs/"):
        for number, line in enumerate(open(file, encoding="utf-8", errors="replace"), 1):
            if re.match(r"\s*(//+!?|\*|#)\s*(Of|What) ", line):
                places.append(f"{file}:{number}: {line.strip()}")
check('comment lines that begin with "Of" or "What"', places, COMMENTS)

n_words, semicolons, long_sentences = 0, [], []
for file in files:
    if not file.endswith(".md") or file in ("CHANGELOG.md", "docs/options.md"):
        continue
    original = text = open(file, encoding="utf-8").read()
    blank = lambda match: re.sub(r"[^\n]", " ", match.group())  # keeps the numbers of lines
    text = re.sub(r"^```.*?^```", blank, text, flags=re.M | re.S)
    text = re.sub(r"^\s*\|.*$|^#.*$|`[^`\n]*`|\]\([^)]*\)", blank, text, flags=re.M)
    n_words += len(re.findall(r"[A-Za-z]+", text))
    paragraph = re.compile(r"(?:^(?!\s*(?:[-*]|\d+\.) ).*\S.*\n?|^\s*(?:[-*]|\d+\.) .*\n?)(?:^(?!\s*(?:[-*]|\d+\.) ).*\S.*\n?)*", re.M)
    for block in paragraph.finditer(text):
        at = block.start()
        for sentence in re.split(r"(?<=[.!?:])\s+(?=[A-Z*_\[(])", block.group()):
            start = text.find(sentence, at)
            line, at = text.count("\n", 0, start) + 1, start + len(sentence)
            words = len(re.findall(r"[A-Za-z0-9]+(?:['.-][A-Za-z0-9]+)*", sentence))
            excerpt = " ".join(original[start:at].split())[:90]
            semicolons += [f"{file}:{line}: {excerpt}"] * sentence.count(";")
            if words > LONGEST_SENTENCE or sentence.count(";") > 1:
                long_sentences.append(f"{file}:{line}: {words} words, {sentence.count(';')} semicolons: {excerpt}")
check("semicolons in 1000 words of README and docs", semicolons, SEMICOLONS, 1000 * len(semicolons) / max(1, n_words))
check(f"sentences of more than {LONGEST_SENTENCE} words or with two semicolons", long_sentences, LONG_SENTENCES)

added = git("log", "--diff-filter=A", "--format=%H", "--", "scripts/check_prose.sh").split()
subjects = git("log", "--no-merges", "--format=%s", f"{added[-1]}..HEAD").splitlines() if added else []
check(f"commit subjects of more than {LONGEST_SUBJECT} characters", [s for s in subjects if len(s) > LONGEST_SUBJECT], 0)
sys.exit(faults > 0)
PYTHON
