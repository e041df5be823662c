#!/usr/bin/env bash
# Installs what building, testing and the demo need on Debian 12 (root or sudo), and packages that are named.
# Does nothing where all is there.
# Usage: scripts/install_packages.sh [PACKAGE...]
set -euo pipefail

packages=(
  g++ cmake ninja-build
  libtorch-dev
  libopencv-core-dev libopencv-imgproc-dev libopencv-imgcodecs-dev  # of OpenCV only what is linked
  nlohmann-json3-dev libcli11-dev libhwy-dev zlib1g-dev
  libgtest-dev
  libexpat1-dev  # the tests parse what reports are made of
  chromium       # the tests look at a report in a browser (120 MB to fetch, 410 MB installed)
  colmap  # the tests let COLMAP's own model_analyzer read what we write
)

missing=()
packages+=("$@")
for package in "${packages[@]}"; do
  [[ $(dpkg-query -W -f='${Status}' "$package" 2>/dev/null) == "install ok installed" ]] || missing+=("$package")
done
if ((${#missing[@]} == 0)); then exit 0; fi

sudo=()
if ((EUID != 0)); then
  if ! command -v sudo >/dev/null; then
    echo "install_packages.sh: needs root or sudo to install: ${missing[*]}" >&2
    exit 1
  fi
  sudo=(sudo)
fi
echo "Installing: ${missing[*]}"
"${sudo[@]}" apt-get update -q
"${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}"
