#!/usr/bin/env bash
# Compiles every CUDA source for each architecture with warnings as errors, and compares registers and spills of the
# kernels with docs/kernel_resources.txt; needs nvcc, but no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH=$PATH:/usr/local/cuda/bin

scripts/install_packages.sh
cmake --preset cuda-compile -DB3DGS_TESTS=OFF
cmake --build --preset cuda-compile --target b3dgs_raster_cuda b3dgs_train_cuda
scripts/kernel_resources.sh --check
