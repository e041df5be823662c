# Features of this LibTorch for communication between processes: c10d's headers, Gloo on CPUs, NCCL on GPUs. All of them
# are optional. Without them, tensors go through rank 0 (src/dist/tensor_group.h), which is slow.

set(B3DGS_C10D OFF)
set(B3DGS_GLOO OFF)
set(B3DGS_NCCL OFF)
set(B3DGS_NCCL_INCLUDE_DIRS)

find_path(B3DGS_C10D_INCLUDE torch/csrc/distributed/c10d/TCPStore.hpp PATHS ${TORCH_INCLUDE_DIRS} NO_DEFAULT_PATH)
if(B3DGS_C10D_INCLUDE)
  set(B3DGS_C10D ON)
  # Gloo's headers must be those that this LibTorch was built with, so only its own folder is searched (Debian:
  # libgloo-dev).
  find_path(B3DGS_GLOO_INCLUDE gloo/rendezvous/store.h PATHS ${TORCH_INCLUDE_DIRS} NO_DEFAULT_PATH)
  if(B3DGS_GLOO_INCLUDE AND EXISTS ${B3DGS_C10D_INCLUDE}/torch/csrc/distributed/c10d/ProcessGroupGloo.hpp)
    set(B3DGS_GLOO ON)
  endif()
  if(B3DGS_TORCH_CUDA)
    # PyTorch's wheels have NCCL as a separate package beside torch: site-packages/nvidia/nccl.
    find_path(B3DGS_NCCL_INCLUDE nccl.h
      HINTS ${TORCH_INCLUDE_DIRS} ${TORCH_INSTALL_PREFIX}/../nvidia/nccl/include ${CUDAToolkit_INCLUDE_DIRS})
    if(B3DGS_NCCL_INCLUDE)
      set(B3DGS_NCCL ON)
      set(B3DGS_NCCL_INCLUDE_DIRS ${B3DGS_NCCL_INCLUDE})
    endif()
  endif()
endif()

if(B3DGS_GLOO)
  set(_b3dgs_cpus "Gloo")
else()
  set(_b3dgs_cpus "through rank 0, slow (for Gloo, Debian: libgloo-dev)")
endif()
message(STATUS "Several processes on CPUs: ${_b3dgs_cpus}")
if(B3DGS_TORCH_CUDA)
  if(B3DGS_NCCL)
    message(STATUS "Several GPUs: NCCL (${B3DGS_NCCL_INCLUDE}/nccl.h)")
  else()
    message(STATUS "Several GPUs: through rank 0, slow (nccl.h not found)")
  endif()
endif()
