#!/usr/bin/env bash
# Compiles every CUDA source for each architecture with warnings as errors, and compares registers and spills of the
# kernels with docs/kernel_resources.txt. Also compiles the tests that need a GPU, as far as possible with LibTorch
# without CUDA, and runs them. Without a GPU they are skipped. Needs nvcc, but no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH=$PATH:/usr/local/cuda/bin

scripts/install_packages.sh --tests
cmake --preset cuda-compile -DB3DGS_TESTS=ON
cmake --build --preset cuda-compile --parallel "$(nproc)" \
  --target b3dgs_raster_cuda b3dgs_train_cuda b3dgs_multi_cuda raster_cuda_tests train_cuda_tests
scripts/kernel_resources.sh --check
scripts/check_rounding.sh
scripts/check_torch_cuda.sh
ctest --test-dir build/cuda-compile -L gpu --no-tests=error --parallel 2 --output-on-failure
