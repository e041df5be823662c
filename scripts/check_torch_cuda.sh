#!/usr/bin/env bash
# Type-checks the code that needs a LibTorch with CUDA, where there is only one without: Debian's package has the headers
# of both, except for one file that CMake generates, which stands in here. Needs the CUDA toolkit, but no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."

cuda=$(dirname "$(dirname "$(PATH=$PATH:/usr/local/cuda/bin command -v nvcc)")")
stand_in=build/torch-cuda-headers
mkdir -p "$stand_in/c10/cuda/impl"
echo '#define C10_CUDA_BUILD_SHARED_LIBS' >"$stand_in/c10/cuda/impl/cuda_cmake_macros.h"

{
  git grep -l -e B3DGS_TORCH_CUDA -e '<c10/cuda/' -- 'src/*.cpp' 'app/*.cpp'
  git ls-files 'tests/train/cuda/*.cpp'
} | sort -u | xargs -P "$(nproc)" -I FILE g++ -std=c++17 -fsyntax-only -Wall -Wextra -Werror -fopenmp \
  -DB3DGS_TORCH_CUDA=1 -DB3DGS_HAS_CUDA=1 "-DB3DGS_VERSION=\"\"" -Isrc -I. -Itests -isystem "$stand_in" \
  -isystem "$cuda/include" -isystem /usr/include/torch/csrc/api/include -isystem /usr/include/opencv4 FILE
echo "code for a LibTorch with CUDA: type-checked"
