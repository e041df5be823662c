#!/usr/bin/env bash
# Installs the packages that are needed to build on Debian 12 (as root or with sudo), and named packages. Does nothing
# if all of them are installed.
# Usage: scripts/install_packages.sh [--tests] [--without-libtorch] [PACKAGE...]
#   --tests             what the tests need, too
#   --without-libtorch  for a build against another LibTorch, one with CUDA
set -euo pipefail

packages=(
  g++ cmake ninja-build
  libopencv-core-dev libopencv-imgproc-dev libopencv-imgcodecs-dev  # only the modules that are linked
  nlohmann-json3-dev libhwy-dev zlib1g-dev libzstd-dev libtiff-dev libutf8proc-dev
  libmicrohttpd-dev  # the live view's server
  libexiv2-dev libgeographiclib-dev  # GPS positions of photographs
  libopenvdb-dev libboost-dev libmeshoptimizer-dev libtinygltf-dev libembree-dev  # meshes; OpenVDB includes Boost
)
libtorch=(
  libtorch-dev
  libgloo-dev  # headers that LibTorch's includes for several processes
)
for argument in "$@"; do
  case $argument in
    --tests)
      packages+=(
        libgtest-dev
        chromium       # shows a report as a reader sees it (120 MB to fetch, 410 MB installed)
        ffmpeg         # decodes the videos that we write; frames of videos for a reconstruction
        colmap         # its model_analyzer reads the scenes that we write; reconstructs a small one
      )
      ;;
    --without-libtorch) libtorch=() ;;
    -*)
      echo "install_packages.sh: error: unknown option: $argument (expected --tests or --without-libtorch)" >&2
      exit 2
      ;;
    *) packages+=("$argument") ;;
  esac
done
packages+=("${libtorch[@]}")

missing=()
for package in "${packages[@]}"; do
  [[ $(dpkg-query -W -f='${Status}' "$package" 2>/dev/null) == "install ok installed" ]] || missing+=("$package")
done
if ((${#missing[@]} == 0)); then exit 0; fi

sudo=()
if ((EUID != 0)); then
  if ! command -v sudo >/dev/null; then
    echo "install_packages.sh: error: needs root or sudo to install: ${missing[*]}" >&2
    exit 1
  fi
  sudo=(sudo)
fi
echo "Installing: ${missing[*]}"
"${sudo[@]}" apt-get update -q
"${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}"
