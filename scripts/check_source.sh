#!/usr/bin/env bash
# The checks that need no build, in a few seconds: format, links, prose, and the layers of src/layers.txt.
# Usage: scripts/check_source.sh
# As a hook of git: ln -s ../../scripts/check_source.sh .git/hooks/pre-commit
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."

scripts/format.sh --check
scripts/check_links.sh
scripts/check_prose.sh

layers=build/layers_test  # compiled by itself, because it tests sources, not a library
if [[ ! $layers -nt tests/structure/layers_test.cpp ]]; then
  mkdir -p build
  ${CXX:-c++} -std=c++17 -DB3DGS_SOURCE="\"$PWD\"" tests/structure/layers_test.cpp -lgtest -lgtest_main -o "$layers"
fi
"$layers" --gtest_brief=1
