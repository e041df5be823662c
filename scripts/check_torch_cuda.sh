#!/usr/bin/env bash
# Type-checks the code that needs a LibTorch with CUDA on machines that have only one without it. Debian's package has
# the headers of both, except for one file that CMake generates and NCCL's, which stubs replace here. Needs the CUDA
# toolkit, but no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."

# nvcc reports where the headers are. The nvcc on the PATH may be a script that starts the one of the toolkit.
cuda_include=$(PATH=$PATH:/usr/local/cuda/bin nvcc --dryrun -x cu -c /dev/null -o /dev/null 2>&1 |
  sed -n 's/^#\$ INCLUDES="-I\([^"]*\)".*/\1/p')
if [[ ! -f $cuda_include/cuda_runtime_api.h ]]; then
  echo "check_torch_cuda.sh: nvcc names '$cuda_include' as the folder of its headers, cuda_runtime_api.h is not there" >&2
  exit 2
fi
stand_in=build/torch-cuda-headers
mkdir -p "$stand_in/c10/cuda/impl"
echo '#define C10_CUDA_BUILD_SHARED_LIBS' >"$stand_in/c10/cuda/impl/cuda_cmake_macros.h"
cat >"$stand_in/nccl.h" <<'END'  # the names that the headers of LibTorch 1.13 use
#define NCCL_MAJOR 2
#define NCCL_MINOR 14
enum ncclResult_t { ncclSuccess, ncclUnhandledCudaError, ncclSystemError, ncclInternalError, ncclInvalidArgument,
                    ncclInvalidUsage, ncclRemoteError, ncclInProgress };
enum ncclDataType_t { ncclChar };
enum ncclRedOp_t { ncclSum };
enum ncclScalarResidence_t { ncclScalarDevice, ncclScalarHostImmediate };
struct ncclUniqueId { char internal[128]; };
typedef struct ncclComm* ncclComm_t;
ncclResult_t ncclCommInitRank(ncclComm_t*, int, ncclUniqueId, int);
ncclResult_t ncclCommAbort(ncclComm_t);
ncclResult_t ncclCommDestroy(ncclComm_t);
ncclResult_t ncclCommGetAsyncError(ncclComm_t, ncclResult_t*);
ncclResult_t ncclRedOpCreatePreMulSum(ncclRedOp_t*, void*, ncclDataType_t, ncclScalarResidence_t, ncclComm_t);
ncclResult_t ncclRedOpDestroy(ncclRedOp_t, ncclComm_t);
const char* ncclGetErrorString(ncclResult_t);
END

{
  git grep -l -e B3DGS_TORCH_CUDA -e '<c10/cuda/' -- 'src/*.cpp' 'app/*.cpp'
  git ls-files 'tests/train/cuda/*.cpp'
} | sort -u | xargs -P "$(nproc)" -I FILE g++ -std=c++17 -fsyntax-only -Wall -Wextra -Werror -fopenmp \
  -DB3DGS_TORCH_CUDA=1 -DB3DGS_HAS_CUDA=1 -DB3DGS_C10D=1 -DB3DGS_GLOO=0 -DB3DGS_NCCL=1 "-DB3DGS_VERSION=\"\"" \
  "-DB3DGS_PROGRAM=\"\"" "-DB3DGS_DIST_RANK=\"\"" \
  -Isrc -I. -Itests -isystem "$stand_in" \
  -isystem "$cuda_include" -isystem /usr/include/torch/csrc/api/include -isystem /usr/include/opencv4 FILE
echo "code for a LibTorch with CUDA: type-checked"
