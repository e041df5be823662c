#!/usr/bin/env bash
# Builds b3dgs for the NVIDIA GPU of this machine. Looks for the GPU, for nvcc and for a LibTorch with CUDA, prints what
# is missing and where to get it, builds in build/gpu, and trains a small synthetic scene on the GPU to test the build.
#
#   scripts/setup_gpu.sh [--libtorch FOLDER] [--check] [-- CMAKE_ARGUMENT...]
#     --libtorch FOLDER  a LibTorch with CUDA, unpacked; otherwise looked for in $LIBTORCH, ./libtorch, ~/libtorch,
#                        /opt/libtorch, /usr/local/libtorch, and in python3's torch
#     --check            only says what there is and what is missing
set -euo pipefail
cd "$(dirname "$0")/.."

libtorch='' is_check=false
while (($# > 0)); do
  case $1 in
    --libtorch)
      libtorch=${2:-}
      [[ -n $libtorch ]] || { echo "setup_gpu.sh: error: missing value: --libtorch FOLDER" >&2; exit 2; }
      shift
      ;;
    --check) is_check=true ;;
    --)
      shift
      break
      ;;
    -h | --help)
      sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
      exit 0
      ;;
    *)
      echo "setup_gpu.sh: error: unknown option: $1 (see --help; arguments for CMake go after --)" >&2
      exit 2
      ;;
  esac
  shift
done

n_missing=0
found() { printf '  found    %-10s %s\n' "$1" "$2"; }
missing() {
  printf '  missing  %-10s %s\n' "$1" "$2"
  n_missing=$((n_missing + 1))
}

# The GPU: at least compute capability 7.5.
capability=
if command -v nvidia-smi >/dev/null &&
  gpu=$(nvidia-smi --query-gpu=name,driver_version,compute_cap --format=csv,noheader 2>/dev/null | head -n 1) &&
  [[ -n $gpu ]]; then
  capability=$(sed 's/.*, *//; s/\.//' <<<"$gpu")
  if ((capability >= 75)); then
    found GPU "${gpu%,*}, compute capability ${gpu##*, }"
  else
    missing GPU "${gpu%,*} has compute capability ${gpu##*, }; 7.5 (Turing, 2018) or later is needed"
  fi
else
  missing GPU "no NVIDIA driver answers nvidia-smi; install the driver of your distribution or from nvidia.com/drivers"
fi

# nvcc: on the PATH or where NVIDIA's packages install it.
nvcc=$(command -v nvcc || ls -1 "${CUDA_HOME:-/usr/local/cuda}/bin/nvcc" /usr/local/cuda-*/bin/nvcc 2>/dev/null | head -n 1 || true)
cuda_version=
if [[ -n $nvcc ]]; then
  cuda_version=$("$nvcc" --version | sed -n 's/.*release \([0-9.]*\),.*/\1/p')
  found nvcc "$nvcc, CUDA $cuda_version"
else
  missing nvcc "install the CUDA toolkit: developer.nvidia.com/cuda-downloads (nvcc may lie outside the PATH: set CUDA_HOME)"
fi

# LibTorch with CUDA: the folder that contains lib/libtorch_cuda.so.
candidates=("$libtorch")
if [[ -z $libtorch ]]; then
  candidates=(${LIBTORCH:+"$LIBTORCH"} libtorch "$HOME/libtorch" /opt/libtorch /usr/local/libtorch)
  if python_torch=$(python3 -c 'import os, torch; print(os.path.dirname(torch.__file__))' 2>/dev/null); then
    candidates+=("$python_torch")
  fi
fi
libtorch=
for candidate in "${candidates[@]}"; do
  if [[ -n $candidate && -e $candidate/lib/libtorch_cuda.so ]]; then
    libtorch=$(realpath "$candidate")
    break
  fi
done
if [[ -n $libtorch ]]; then
  found LibTorch "$libtorch"
else
  missing LibTorch "none with CUDA in: ${candidates[*]}"
  echo "           Download it from pytorch.org (Get Started: LibTorch, C++, the CUDA version nearest to your nvcc's" \
    "${cuda_version:-version}),"
  echo "           unpack it, and name the folder: scripts/setup_gpu.sh --libtorch FOLDER"
fi

if ((n_missing > 0)); then
  echo "setup_gpu.sh: error: $n_missing of 3 are missing; training on the CPU needs none of them: scripts/demo.sh" >&2
  exit 1
fi
if $is_check; then exit 0; fi

if command -v apt-get >/dev/null; then scripts/install_packages.sh --without-libtorch; fi
cmake --preset gpu -DCMAKE_CUDA_COMPILER="$nvcc" -DCMAKE_CUDA_ARCHITECTURES="$capability" \
  -DCMAKE_PREFIX_PATH="$libtorch" "$@"
cmake --build --preset gpu --target b3dgs
b3dgs=build/gpu/app/b3dgs

trial=$(mktemp -d)
trap 'rm -rf -- "$trial"' EXIT
"$b3dgs" synth orbit "$trial/scene" --views 12 --width 320 --height 240 --quiet
"$b3dgs" train -s "$trial/scene" -m "$trial/model" --iterations 300 --device cuda --quiet

cat <<DONE

Done: a trial training on the GPU passed. The program is $b3dgs; to have it on the PATH:
  cmake --install build/gpu --prefix ~/.local
Train a COLMAP scene (a folder with images/ and sparse/0/):
  $b3dgs train SCENE -m MODEL
DONE
